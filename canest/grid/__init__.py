"""The 50 Hz grid in event time: from irregular samples to one column per role."""
