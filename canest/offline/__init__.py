"""Recorded logs: replay, comparison of estimators, errors against truth."""
