"""Numba kernels: pure functions on scalars and arrays."""

#: A slot of a particle that has no texture yet, but a coarse record.
FIRST_LIGHT = -2

#: Bit of the slot of a texture that was made for another light: its codes mean the second half of a decoding table of 512.
STALE = 1 << 30
