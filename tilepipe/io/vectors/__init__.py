"""Tables of lines and polygons: read, and written in the formats that GIS read."""
