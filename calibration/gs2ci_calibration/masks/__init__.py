"""How the modulator is seen by the sensor: where it falls (`registration_step`) and what passes it (`masks_step`)."""
