"""Santec SLM-200 class LCoS panels over their USB FIFO. EXPERIMENTAL: never confirmed on hardware by us.

The vendor publishes no protocol; this follows what is publicly known of it. `packets` is pure, `driver` talks.
Import the module you need; this file imports nothing.
"""
