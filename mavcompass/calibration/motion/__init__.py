"""Calibration by any motion: sections of it, their fit with an honest sigma, and a running fit."""
