"""What the daemon says of itself: status, metrics, log lines, terminal views."""
