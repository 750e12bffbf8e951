"""Simulated exposures: light is integrated over time here, never summed from masks as the solver does."""
