"""What readers of several formats share: clock, samples, corrections in force, large files in pieces."""
