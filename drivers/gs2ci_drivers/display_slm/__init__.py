"""Santec SLM-200 class LCoS panels over their USB FIFO. EXPERIMENTAL: not confirmed on hardware.

The vendor publishes no protocol; this follows what is publicly known of it. `packets` is pure, `driver` does the I/O.
Import the module you need; this file imports nothing.
"""
