"""What a fit steps, and how: Gaussians and poses."""
