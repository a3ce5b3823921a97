"""Borders between labels as arcs, and what is made of them: simplified coverages, polygons, straight lines."""
