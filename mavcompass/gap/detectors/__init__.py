"""Detectors of each reading, before any search: repeats, coarse steps, scatter, what changes each reading."""
