"""The vehicle: longitudinal model, its force terms (effects), and the samples it hands to estimators."""
