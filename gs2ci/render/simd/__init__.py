"""Numba kernels that say themselves which 16 float32 lanes go together: arithmetic, exp and log, transposes."""
