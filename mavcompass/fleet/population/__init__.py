"""The population: what the vehicles of a fleet have in common, and which is not like the others."""

from mavcompass.fleet.population.distribution import Distribution, learn, write_distribution
from mavcompass.fleet.population.odd import FALSE_NAMES, Odd

__all__ = ["FALSE_NAMES", "Distribution", "Odd", "learn", "write_distribution"]
