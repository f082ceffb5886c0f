"""Kidambi et al. (2014): Kalman filters and grade observers."""
