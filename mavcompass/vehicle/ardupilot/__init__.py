"""ArduPilot's compass parameters: read, planned and written."""
