"""The paper's own parts, which the default lacks: preset, fine stage, proxies, VGGT, density rules."""
