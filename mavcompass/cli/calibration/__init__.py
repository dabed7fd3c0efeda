"""The two kinds of calibration that the command runs: of a recording, and of a live vehicle."""
