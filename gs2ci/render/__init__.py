"""Gaussian scenes and their rendering: parameters, cameras, the float64 definition and the fast paths."""
