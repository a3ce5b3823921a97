"""Coordinate reference systems, units of length, and lengths on the ground."""
