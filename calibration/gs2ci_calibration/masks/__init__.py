"""The modulator as the sensor sees it: its position (`registration_step`) and its transmission (`masks_step`)."""
