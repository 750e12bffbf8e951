"""Designs of a capture: checked by reconstructions, and shown as a table and a picture."""
