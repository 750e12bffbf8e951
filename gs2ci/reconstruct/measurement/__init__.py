"""What is known and assumed of a measurement: its coding, its faulty pixels, its light, and its held-out pixels."""
