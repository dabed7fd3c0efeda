"""Telemetry logs (.tlog): MAVLink frames with the time at which each was heard."""
