"""Files: rasters, point clouds, CRS, tables, all written whole or not at all."""
