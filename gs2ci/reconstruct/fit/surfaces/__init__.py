"""Surfaces from the views of a fit, the depths of regions, and what lies beyond the borders."""
