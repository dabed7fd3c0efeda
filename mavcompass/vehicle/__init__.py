"""The only place with MAVLink on a wire: links, codec, autopilot dialects, transactions."""
