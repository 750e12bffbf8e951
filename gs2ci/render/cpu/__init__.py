"""The fast CPU rasteriser: Numba kernels over an explicit 16-lane vector type."""
