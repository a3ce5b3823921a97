"""The CUDA form of the kernels: grids of threads that call the same rules as the loops of the CPU.

Nothing here is imported before an array of a device comes in, so that none of CUDA is needed without one.
"""
