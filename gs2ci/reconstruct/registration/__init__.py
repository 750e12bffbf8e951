"""Registration: the true position, blur and transmission of the masks, estimated from the measurement itself."""
