"""Vehicles of another make: cases for the blind trial that share no physics with simulation and diagnosis."""

from mavcompass.gap.trial.vehicles.cases import Tier, VehicleCase, make_case

__all__ = ["Tier", "VehicleCase", "make_case"]
