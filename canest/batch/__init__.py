"""Many logs side by side on all cores."""
