"""What every simulated flight controller has, whatever firmware runs on it."""
