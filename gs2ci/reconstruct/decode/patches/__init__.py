"""Decoding with groups of similar patches, which are nearly of low rank (Liu 2019, DeSCI)."""
