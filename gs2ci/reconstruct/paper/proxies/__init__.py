"""Proxy views: rough per-view images from the measurement and the masks alone, for geometry (paper, section III-B)."""
