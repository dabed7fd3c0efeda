"""What single readings tell before any search: repeats, coarse steps, scatter, what changes each reading."""

from mavcompass.gap.traces.rapid import Rapid, follows_way, keeps_step
from mavcompass.gap.traces.scattered import excess_variance, neighbours, quiet_doubt, quiet_scatter
from mavcompass.gap.traces.traces import Traces, find_traces, searched

__all__ = [
    "Rapid",
    "Traces",
    "excess_variance",
    "find_traces",
    "follows_way",
    "keeps_step",
    "neighbours",
    "quiet_doubt",
    "quiet_scatter",
    "searched",
]
