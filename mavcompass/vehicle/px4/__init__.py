"""PX4's compass parameters: read, planned and written."""
