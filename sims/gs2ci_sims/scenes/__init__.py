"""Scenes that the simulated bench can look at: photographs with depth, procedural ones, Gaussian files."""
