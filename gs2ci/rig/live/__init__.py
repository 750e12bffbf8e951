"""The bench in a browser while one aligns it."""
