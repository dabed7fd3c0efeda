"""The MAVLink protocol as a description: its frames, and its messages as pymavlink's dialect has them."""
