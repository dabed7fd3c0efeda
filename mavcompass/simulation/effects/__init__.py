"""The registry of physical effects: one forward model per effect, for simulating and for explaining.

    from mavcompass.simulation import effects

    effects.catalogue()                                   # every effect, by id
    effects.parse("hard_iron:x=100,y=-50")                # a setting: an effect with parameter values
    effects.Distortion([effects.parse("transport_lag")])  # acts on a live vehicle, block by block

Adding an effect is adding one file to `causes/`.
"""

from mavcompass.simulation.effects.effect import (
    Distortion,
    Effect,
    Memory,
    Misfit,
    Parameter,
    Setting,
    Signals,
    Stage,
)
from mavcompass.simulation.effects.registry import (
    catalogue,
    default,
    detected_by,
    distortion,
    get,
    parse,
    read_preset,
    spell,
)

__all__ = [
    "Distortion",
    "Effect",
    "Memory",
    "Misfit",
    "Parameter",
    "Setting",
    "Signals",
    "Stage",
    "catalogue",
    "default",
    "detected_by",
    "distortion",
    "get",
    "parse",
    "read_preset",
    "spell",
]
