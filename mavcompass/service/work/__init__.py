"""What the service does when asked: calibrations, checks, undoing and diagnoses, and what is kept of them."""
