"""Object and building polygons from lidar heights (Galvanin et al. 2007)."""
