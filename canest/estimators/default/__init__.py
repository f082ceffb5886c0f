"""The default estimator: a sum of Kalman filters over the inverse mass (docs/theory.md)."""
