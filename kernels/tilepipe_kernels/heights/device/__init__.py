"""CUDA forms of the kernels of this folder: grids that call the same rules."""
