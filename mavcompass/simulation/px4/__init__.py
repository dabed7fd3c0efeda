"""PX4's firmware, as it was seen to behave."""
