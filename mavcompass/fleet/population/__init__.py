"""The population: what the vehicles of a fleet have in common, and which is not like the others."""

from mavcompass.fleet.population.distribution import FALSE_NAMES, Distribution, Odd, learn, write_distribution

__all__ = ["FALSE_NAMES", "Distribution", "Odd", "learn", "write_distribution"]
