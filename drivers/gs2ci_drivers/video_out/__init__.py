"""Modulators that are a second display of this computer: LCoS panels, DMD projectors."""
