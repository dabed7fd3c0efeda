"""The service's face on the vehicle's link: a MAVLink component that tells, answers and asks for messages."""
