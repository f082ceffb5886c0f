"""The default estimator of version 0.1."""
