"""The twins: one per driver, each playing the firmware below the port. Drivers never know that they exist."""
