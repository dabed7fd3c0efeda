"""The simulated world, vehicle, sensors and flight controller, without sockets.

`vehicle.SimulatedAutopilot` is one vehicle; `effects` the catalogue of what can be wrong with it.
"""
