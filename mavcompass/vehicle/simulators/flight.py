"""What a simulator has to know of a flight before it starts."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Flight:
    """Hold where a flight begins, and of what.

    Attributes:
        kind: "rover", "boat" or "copter". pivots: it turns on the spot.
        home: latitude deg, longitude deg, altitude m; None for anywhere.
        heading_deg: where the nose points.
    """

    kind: str
    pivots: bool
    home: tuple[float, float, float] | None
    heading_deg: float
