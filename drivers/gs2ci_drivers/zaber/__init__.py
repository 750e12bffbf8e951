"""Zaber stages over their ASCII protocol: `packets` and `flags` are pure, `driver` does the I/O."""
