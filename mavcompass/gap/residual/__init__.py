"""What a fit leaves: the floor where nothing is wrong, and tests whether the rest is chance."""
