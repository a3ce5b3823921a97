"""Slow, obviously right versions of the kernels: the oracles of the tests."""
