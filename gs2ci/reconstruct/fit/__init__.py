"""Fitting Gaussians and poses to the measurement."""
