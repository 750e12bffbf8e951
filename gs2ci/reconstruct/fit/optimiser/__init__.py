"""What a fit steps, and how: Gaussians, poses, and the exchange between the two."""
