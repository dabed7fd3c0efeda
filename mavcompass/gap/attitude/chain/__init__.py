"""A chain of states that know their neighbours: at which times they stand, their equations, the solution."""

from mavcompass.gap.attitude.chain.equations import Chain, Solved
from mavcompass.gap.attitude.chain.knots import KNOT_S, knots_of, silences
from mavcompass.gap.attitude.chain.tridiagonal import Reduced

__all__ = ["KNOT_S", "Chain", "Reduced", "Solved", "knots_of", "silences"]
