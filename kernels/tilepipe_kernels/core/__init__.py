"""What all kernels rest on: arrays of both backends, compilation, random numbers by site, sums in a fixed order."""
