"""MAVLink frames: bytes into messages and back."""
