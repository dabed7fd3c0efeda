"""Fit hypotheses to a replay, and search the set of effects that explains it best."""
