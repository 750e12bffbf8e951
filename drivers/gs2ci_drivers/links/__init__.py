"""The real ports: USB HID, USB bulk, serial line, Linux system calls. One file per library that they rest on."""
