"""Cameras of the GenICam family: GigE Vision, USB3 Vision, CoaXPress, by their makers' GenTL producers."""
