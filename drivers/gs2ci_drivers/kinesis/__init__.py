"""Thorlabs motion controllers by the APT protocol: K-Cubes, T-Cubes, benchtop controllers and integrated stages."""
