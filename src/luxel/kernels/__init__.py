"""Numba kernels: pure functions on scalars and arrays."""

#: A slot of a particle that has no texture yet, but a coarse record.
FIRST_LIGHT = -2
