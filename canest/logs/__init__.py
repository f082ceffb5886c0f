"""Recorded logs in, results out: tolerant readers and streaming writers."""
