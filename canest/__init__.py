"""canest: vehicle mass and road grade from the CAN bus, at 50 Hz, live or from logs."""

__version__ = "0.1.0"
