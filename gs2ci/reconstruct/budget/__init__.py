"""The best result within a number of seconds: what settings cost here, and which to run."""
