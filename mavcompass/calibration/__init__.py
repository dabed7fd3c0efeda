"""The calibration methods, their uncertainty and their verdict."""
