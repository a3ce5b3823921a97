"""Tiles, seams and their reconciliation: integers only."""
