"""Density rules that the paper compares with its own."""
