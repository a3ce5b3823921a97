"""Scores of lines, polygons and edges against a truth."""
