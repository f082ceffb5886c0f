"""The daemon's condition: status, metrics, log lines, terminal views."""
