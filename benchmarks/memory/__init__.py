"""Whether runs keep to the memory that was planned for them, for the worst that a raster can hold."""
