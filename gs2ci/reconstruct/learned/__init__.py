"""All that needs trained weights: denoisers, image priors, perceptual distance, VGGT, and their conversion to ONNX."""
