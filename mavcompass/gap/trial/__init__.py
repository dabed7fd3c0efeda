"""The blind trial: the diagnosis examined on cases whose labels were sealed before it ran."""

from mavcompass.gap.trial.cases import Generator
from mavcompass.gap.trial.trial import Trial, run_trial

__all__ = ["Generator", "Trial", "run_trial"]
