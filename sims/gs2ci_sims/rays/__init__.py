"""Scenes drawn ray by ray, in float64: Gaussians and meshes. Nothing here is shared with the solver's rasteriser."""
