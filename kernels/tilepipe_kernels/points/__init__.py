"""Points of lidar clouds to cells of rasters."""
