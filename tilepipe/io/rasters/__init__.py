"""Rasters: read window by window as one mosaic, published as cloud-optimised GeoTIFF."""
