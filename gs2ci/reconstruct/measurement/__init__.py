"""The measurement: its coding model, faulty pixels, light, lens, and held-out pixels."""
