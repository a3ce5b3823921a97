"""Kernels on the device beside the CPU; on numba's CUDA simulator where there is no GPU."""
