"""Street centerlines from lidar intensity (Mendes & Dal Poz 2012)."""
