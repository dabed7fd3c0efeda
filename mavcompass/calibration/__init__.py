"""Calibration: from still positions and turns, or any motion, to a correction with its covariance."""
