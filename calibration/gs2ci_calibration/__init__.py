"""Calibration of a bench. Still empty: the first procedures come with the rig."""
