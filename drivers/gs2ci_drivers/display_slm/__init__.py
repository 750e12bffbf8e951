"""Santec SLM-200 class LCoS panels over their USB FIFO. EXPERIMENTAL: not confirmed on hardware.

The vendor publishes no description of the protocol; this follows its own source for macOS (SlmCtrl.m, Santec
Corporation, 2022, in public code) and its manual of the library SLMFunc. `packets` is pure, `driver` does the I/O.
Import the module you need; this file imports nothing.
"""
