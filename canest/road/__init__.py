"""The road from many drives: grade by position, fused from passes, and found again while driving."""
