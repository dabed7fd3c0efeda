"""The calibration and the pre-flight check as state machines without clock or sockets."""
