"""What stands behind a raster: files, VRTs, Zarr stores, arrays."""
