"""Regions and their graphs: growing, quadtree, adjacency, merging, colouring."""
