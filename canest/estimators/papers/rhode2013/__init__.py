"""Rhode and Gauterin (2013): total least squares, multiple forgetting, four parameters."""
