"""The Gaussians of a fit: the first ones, how a shot's camera shows them, how they move."""
