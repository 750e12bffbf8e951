"""Everything that needs trained weights: denoisers, perceptual distance, VGGT, decoders, and conversion to ONNX."""
