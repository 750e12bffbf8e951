"""Simulated exposures. Shares no forward model with the solver: light is integrated here, not summed from masks."""
