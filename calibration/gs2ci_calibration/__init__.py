"""Calibration of a bench: measuring the properties that the solver needs. `procedures` lists the steps."""
