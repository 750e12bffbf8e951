"""Density rules: where Gaussians are added and removed. One rule per file."""
