"""Vahidi, Stefanopoulou and Peng (2005): least squares with forgetting."""
