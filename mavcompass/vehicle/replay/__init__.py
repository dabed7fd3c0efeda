"""A recording played as if its vehicle were there."""
