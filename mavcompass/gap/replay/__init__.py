"""A recording beside its nominal simulation: rows, field, iron, noise, and what is solved for besides."""
