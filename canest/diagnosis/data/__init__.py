"""The data of a diagnosis: drives decoded once, their residual, the regression problem."""
