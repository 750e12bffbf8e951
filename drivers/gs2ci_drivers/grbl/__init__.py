"""Stages on a GRBL 1.1 controller: `packets` is pure, `driver` does the I/O."""
