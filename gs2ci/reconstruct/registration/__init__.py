"""Where the masks really lie and how they met the light, estimated from the measurement itself."""
