"""PX4's own log (ULog, .ulg)."""
