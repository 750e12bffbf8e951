"""Kernels of a fit: Numba's, and their counterparts for a device."""
