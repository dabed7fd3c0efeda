"""What single readings tell before any search: repeats, coarse steps, scatter, what changes each reading."""
