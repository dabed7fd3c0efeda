"""ArduPilot's own log (DataFlash): binary (.bin) or turned into text (.log)."""
