"""Does this config fit this log or bus, and if not, which signal stops the estimator?"""
