"""Track CSV: columns by name, from anywhere."""
