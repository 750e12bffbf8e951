"""The real ports: USB HID, USB bulk, serial line, Linux system calls, GenTL, video output. One file per library."""
