"""Scenes for the simulated bench: photographs with depth, procedural scenes, Gaussian files."""
