"""Corners followed through the views."""
