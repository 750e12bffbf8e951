"""Decoders: from the coded measurement to approximate views, pixel by pixel and without geometry."""
