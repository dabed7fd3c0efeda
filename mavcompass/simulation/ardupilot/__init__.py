"""ArduPilot's firmware, as it was seen to behave."""
