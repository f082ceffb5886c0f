"""The search for the effects that explain the residual."""
