"""Publishers: programs of their own that follow a daemon and hand its estimates to other systems."""
