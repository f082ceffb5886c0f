"""The live side: the bus, the clock and the operating system around the pure pipeline."""
