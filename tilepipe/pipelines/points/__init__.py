"""Rasters from lidar point clouds."""
