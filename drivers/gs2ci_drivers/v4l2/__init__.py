"""A camera behind the Linux kernel's V4L2 interface, by our own ctypes layer; read `driver.V4l2Sensor` first."""
