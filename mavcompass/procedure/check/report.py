"""What a check before a journey found, as a list with one verdict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from mavcompass.kinds import HOVERING
from mavcompass.printable import counted, named
from mavcompass.procedure.check import items
from mavcompass.procedure.check.items import CheckItem, Verdict
from mavcompass.procedure.turning import strategies_for
from mavcompass.procedure.vehicle_state import VehicleIdentity

SCHEMA = "mavcompass.check/1"
_GOES = {**dict.fromkeys((*HOVERING, "plane"), "fly"), "sub": "dive", "boat": "sail", "unknown": "set out"}


def _is_calibration(item: CheckItem) -> bool:
    return "alibrate" in item.remedy


@dataclass(frozen=True, slots=True)
class CheckReport:
    """Hold the list; `verdict` is that of its worst item, `remarks` what else to know of the parameters."""

    identity: VehicleIdentity
    items: tuple[CheckItem, ...]
    turned: bool
    duration_s: float
    remarks: tuple[str, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """Return pass, warn or fail."""
        return items.worst(item.verdict for item in self.items)

    @property
    def calibration_advised(self) -> bool:
        """Tell whether a calibration is the remedy of something that is not right."""
        return any(item.verdict != "pass" and _is_calibration(item) for item in self.items)

    @property
    def turns_itself(self) -> bool:
        """Tell whether a calibration can have the vehicle turn on the spot."""
        return bool(strategies_for(self.identity.kind, self.identity.autopilot))

    def summary(self) -> str:
        """Say it in a sentence, and where something is wrong in another that nothing was turned."""
        wrong = [item for item in self.items if item.verdict == self.verdict]
        go, count = _GOES.get(self.identity.kind, "drive"), counted(len(self.items), "check")
        told = self.turned or any(item.name == "turn" for item in self.items)
        unturned = "" if told else " No turn was made."
        match self.verdict:
            case "pass":
                return f"Fit to {go}: {count} passed{'' if self.turned else ', without a turn'}."
            case "warn":
                more = f", and {len(wrong) - 1} more" if len(wrong) > 1 else ""
                return f"Fit to {go}, with care: {wrong[0].text.rstrip('.')}{more}.{unturned}"
        cured = sorted({item.instance for item in wrong if item.instance and _is_calibration(item)})
        what = f"calibrate {named([f'compass {i}' for i in cured])}" if cured else wrong[0].text.rstrip(".")
        return f"Not fit to {go}: {what}. {len(wrong)} of {count} failed.{unturned}"

    def to_json(self) -> dict[str, Any]:
        """Return the machine-readable form."""
        return {
            "schema": SCHEMA,
            "autopilot": self.identity.autopilot,
            "vehicle": self.identity.kind,
            "verdict": self.verdict,
            "summary": self.summary(),
            "turned": self.turned,
            "calibration_advised": self.calibration_advised,
            "items": [item.to_json() for item in self.items],
            "remarks": list(self.remarks),
            "duration_s": self.duration_s,
        }
