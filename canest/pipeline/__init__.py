"""The one way through: from frames (or table rows) to estimates, for a config."""
