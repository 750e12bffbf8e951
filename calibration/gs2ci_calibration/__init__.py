"""Calibration of a bench: from parts to numbers that the solver can trust. `procedures` lists the steps."""
