"""Depth maps of views: plane sweeps, what several maps agree on, what hides what."""
