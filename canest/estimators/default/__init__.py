"""The estimator that is to become the default: see docs/theory.md, whose sections are the modules here."""
