"""The world without a flight controller: field, ground, body, hands, sensors, and their noise."""
