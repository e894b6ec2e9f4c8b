"""Numba kernels: pure functions on scalars and arrays."""
