"""The estimators: each of the papers' methods and our own, behind one interface."""
