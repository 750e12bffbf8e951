"""Scenes drawn ray by ray, in float64: Gaussians and meshes. The modules share no code with the solver's rasteriser."""
