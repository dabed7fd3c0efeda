"""Diagnosis of the gap between the simulation and a recording."""
