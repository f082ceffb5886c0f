"""The live page: a program of its own that watches a daemon and serves one read-only page."""
