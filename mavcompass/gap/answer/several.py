"""Several recordings of one vehicle: which causes are the vehicle's, and which belong to one flight.

Every flight has its own nuisances (yaw, place, noise), so that the joint least squares of what they share is
the mean of what each flight tells alone, weighed by its covariance. A cause that several flights tell alike
is the vehicle's; one that comes once, or every time with another value, is the flight's: a magnet nearby,
another place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mavcompass.gap.result import Cause, Diagnosis, plain
from mavcompass.simulation.effects import get
from mavcompass.simulation.effects.effect import MOMENTS

# Models are not exact: values agree within four sigmas, or a fifth of their size.
_SIGMAS, _SHARE = 4.0, 0.2


@dataclass(frozen=True, slots=True)
class SharedCause:
    """Hold a cause of the vehicle: joint parameters and intervals, in how many flights it was named."""

    cause: Cause
    named_in: int


@dataclass(frozen=True, slots=True)
class VehicleDiagnosis:
    """Hold the diagnoses of several flights of one vehicle, and what they share.

    `flights` are in the order given; `own` lists for each the causes that are the flight's alone.
    """

    flights: tuple[Diagnosis, ...]
    shared: tuple[SharedCause, ...]
    own: tuple[tuple[Cause, ...], ...]

    def to_json(self) -> dict[str, object]:
        """Return one document: the vehicle's causes, and each flight's whole diagnosis."""
        return {
            "schema": "mavcompass.gap-vehicle/1",
            "vehicle": [
                {
                    **{name: plain(getattr(s.cause, name)) for name in ("effect", "parameters", "ci95")},
                    "named_in": s.named_in,
                    "of": len(self.flights),
                }
                for s in self.shared
            ],
            "flights": [
                {**flight.to_json(), "of_this_flight": [c.effect for c in own]}
                for flight, own in zip(self.flights, self.own, strict=True)
            ],
        }

    def lines(self) -> list[str]:
        """Say it for a terminal."""
        out = []
        for s in self.shared:
            values = ", ".join(f"{name} {value:.4g}" for name, value in s.cause.parameters.items())
            out.append(
                f"of the vehicle (in {s.named_in} of {len(self.flights)} flights): {s.cause.effect}: {values}"
            )
        for flight, own in zip(self.flights, self.own, strict=True):
            if own:
                out.append(f"of one flight ({flight.path}): {', '.join(c.effect for c in own)}")
        return out or ["nothing that the flights share, nothing of one alone"]


def together(flights: Sequence[Diagnosis]) -> VehicleDiagnosis:
    """Tell the causes that flights of one vehicle share from those of one flight."""
    shared: list[SharedCause] = []
    for effect in sorted({c.effect for d in flights for c in d.causes}):
        # What happens around a vehicle or at one moment is not its own, however often it comes.
        if not get(effect).of_vehicle:
            continue
        told = [c for d in flights for c in d.causes if c.effect == effect]
        could = [d for d in flights if effect not in dict(d.not_testable)]
        if len(told) > 1 and 2 * len(told) > len(could) and _agree(told):
            shared.append(SharedCause(_joint(told), len(told)))
    names = {s.cause.effect for s in shared}
    own = tuple(tuple(c for c in d.causes if c.effect not in names) for d in flights)
    return VehicleDiagnosis(tuple(flights), tuple(shared), own)


def _sigma(cause: Cause, name: str) -> float:
    low, high = cause.ci95.get(name, (math.nan, math.nan))
    sigma = (high - low) / 3.92
    scale = next(p.scale for p in get(cause.effect).parameters if p.name == name)
    return sigma if math.isfinite(sigma) and sigma > 0.0 else max(scale, 1e-9)


def _agree(causes: Sequence[Cause]) -> bool:
    """Tell whether the parameters of a cause are the same in all flights, each within its doubt."""
    names = [n for n in causes[0].parameters if n not in MOMENTS]
    size = math.sqrt(sum(max(abs(c.parameters.get(n, 0.0)) for c in causes) ** 2 for n in names))
    for name in names:
        joint, _ = _mean(causes, name)
        for cause in causes:
            off = abs(cause.parameters.get(name, 0.0) - joint)
            if off > max(_SIGMAS * _sigma(cause, name), _SHARE * size):
                return False
    return True


def _mean(causes: Sequence[Cause], name: str) -> tuple[float, float]:
    weights = [_sigma(c, name) ** -2 for c in causes]
    total = sum(weights)
    return sum(
        w * c.parameters.get(name, 0.0) for w, c in zip(weights, causes, strict=True)
    ) / total, total**-0.5


def _joint(causes: Sequence[Cause]) -> Cause:
    parameters, ends = {}, {}
    for name in causes[0].parameters:
        value, sigma = _mean(causes, name)
        parameters[name], ends[name] = value, (value - 1.96 * sigma, value + 1.96 * sigma)
    probability = 1.0 - math.prod(1.0 - c.probability for c in causes)
    return Cause(causes[0].effect, parameters, ends, probability, ())
