"""A camera behind the Linux kernel's V4L2 interface, by our own ctypes layer; `driver.V4l2Sensor` is the door."""
