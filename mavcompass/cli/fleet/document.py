"""The machine-readable result of the work on a fleet."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mavcompass.fleet.run import FleetResult
    from mavcompass.fleet.summary import Summary, Vehicle


def document(result: FleetResult, summary: Summary, out: Path, page: Path) -> dict[str, object]:
    """Return the document of `--json`."""
    return {
        "schema": "mavcompass.fleet/1",
        "work": summary.work,
        "asked": result.asked,
        "examined": result.examined,
        "kept": result.kept,
        "recordings": summary.recordings,
        "table": out,
        "report": page,
        "errors": [{"recording": recording, "error": error} for recording, error in summary.errors],
        "not_accepted": [{"recording": recording, "why": why} for recording, why in summary.not_accepted],
        "slowest": [{"recording": recording, "seconds": seconds} for recording, seconds in summary.slowest],
        "effects": [asdict(effect) for effect in summary.effects],
        "vehicles": [_vehicle(vehicle) for vehicle in summary.vehicles],
        "odd": [asdict(odd) for odd in summary.population.odd] if summary.population is not None else [],
        "look_first": [vehicle.name for vehicle in summary.look_first],
    }


def _vehicle(vehicle: Vehicle) -> dict[str, object]:
    return {
        "name": vehicle.name,
        "kind": vehicle.kind,
        "recordings": vehicle.recordings,
        "errors": vehicle.errors,
        "not_accepted": vehicle.not_accepted,
        "effects_mgauss": dict(vehicle.effects),
        "why": list(vehicle.why),
        "compasses": [
            {
                "compass": history.compass,
                "device_id": history.device_id,
                "rate_deg_per_30_days": history.rate_deg_per_30_days,
                "history": [asdict(point) for point in history.points],
            }
            for history in vehicle.histories
        ],
    }
