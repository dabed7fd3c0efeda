"""The simulated world, vehicle, sensors and flight controller, without sockets."""
