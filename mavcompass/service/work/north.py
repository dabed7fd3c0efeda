"""Keep what the receiver taught of true north, by compass and place, and use it there again.

Kept is what of the model's declination was off, so that it holds while that drifts. The rocks that turn a
needle lie within ten kilometres, most of them nearer: with the distance from where it was learnt its doubt
grows, to that of two places that know nothing of each other.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Iterable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from mavcompass.compass_parameters import orientation_name
from mavcompass.earth_field import EarthField
from mavcompass.files import read_text
from mavcompass.frames import wrap_pi
from mavcompass.heading.true_north import NorthLearner, NorthSeen, TrueNorth
from mavcompass.installation.private_files import write_private
from mavcompass.procedure.vehicle_state import metres_apart
from mavcompass.service.view import VehicleView
from mavcompass.service.work.clock import utc_now
from mavcompass.vehicle.dialects import make_dialect

_log = logging.getLogger(__name__)

# What ten minutes' driving goes about, and the rocks' distance. Each drive is a row; so many are kept.
_SAME_KM, _ROCKS_KM, _MOST_ROWS = 1.0, 10.0, 1000


class NorthKeeper:
    """Learn on the way; everything is the station's thread's."""

    def __init__(self, path: Path) -> None:
        """Take what was learnt before; a file that cannot be read is begun anew."""
        self._path = path
        self._rows: list[dict[str, Any]] = []
        # The latest row of each compass and source: who heard its fixes, and up to which.
        self._latest: dict[str, tuple[NorthLearner, int, dict[str, Any]]] = {}
        try:
            self._rows = [row | {"seen": NorthSeen(**row["seen"])} for row in json.loads(read_text(path))]
        except FileNotFoundError:
            pass
        except (OSError, ValueError, TypeError, LookupError) as error:
            _log.warning("%s cannot be read (%s): true north is learnt anew", path, error)

    def learn(self, view: VehicleView, instance: int) -> None:
        """Keep what a compass's fixes show, and tell the compass all that is known here."""
        compass, world, where = view.compasses.get(instance), view.world, view.state.where
        if compass is None or world is None or where is None:
            return
        # Another calibration or mounting has another north.
        in_force = make_dialect(view.identity.autopilot).correction(view.parameters, instance)
        mounted = orientation_name(view.identity.autopilot, view.parameters, instance)
        about = f"{view.key} {view.device_id(instance)} {mounted} {in_force}"
        now = TrueNorth.of(world, compass.fixes.seen(view.identity.kind))
        fresh = [self._take(about, compass.fixes, where, one, world) for one in now.learnt]
        if any(fresh):
            self._save()
        here = [row for row in self._rows if row["about"] == about]
        rows = [(row["seen"], 1e-3 * math.hypot(*metres_apart(row["at"], where))) for row in here]
        compass.set_north((*joined(rows, world), *now.doubted))

    def _take(
        self, about: str, fixes: NorthLearner, at: tuple[float, ...], seen: NorthSeen, world: EarthField
    ) -> bool:
        """Take what was seen, in place of the latest row where both hold the same fixes; tell if new."""
        (first, last), key = fixes.numbers, f"{about} {seen.by}"
        heard_by, until, row = self._latest.get(key, (None, 0, {}))
        if heard_by is not fixes or first >= until:
            row = {}
            self._rows = [*self._rows[1 - _MOST_ROWS :], row]
        beyond = replace(seen, turn_rad=float(wrap_pi(seen.turn_rad - world.declination_rad)))
        row.update(about=about, learnt_at=utc_now(), at=at, seen=beyond)
        self._latest[key] = fixes, last, row
        return heard_by is not fixes or until != last

    def _save(self) -> None:
        try:
            write_private(self._path, json.dumps(self._rows, default=asdict))
        except OSError as error:
            _log.warning("what was learnt of true north could not be kept: %s", error)


def joined(rows: Iterable[tuple[NorthSeen, float]], world: EarthField) -> list[NorthSeen]:
    """Join what was learnt so many kilometres away by inverse variance, for each source.

    What is steady of a vehicle is the same in all rows; rows that differ by more than chance are less sure.
    """
    by: dict[str, list[tuple[NorthSeen, float]]] = {}
    for row, km in rows:
        if km < _ROCKS_KM:
            rocks2 = max(world.declination_sigma_rad, abs(row.turn_rad)) ** 2
            faded2 = -2.0 * rocks2 * math.expm1(-max(km - _SAME_KM, 0.0) / _ROCKS_KM)
            by.setdefault(row.by, []).append((row, 1.0 / (row.chance_rad**2 + faded2)))
    found = []
    for name, some in by.items():
        total = sum(weight for _, weight in some)
        mean = sum(weight * row.turn_rad for row, weight in some) / total
        spread = sum(weight * (row.turn_rad - mean) ** 2 for row, weight in some)
        chance = math.sqrt(max(spread / max(len(some) - 1, 1), 1.0) / total)
        steady, seconds = max(row.steady_rad for row, _ in some), sum(row.seconds for row, _ in some)
        found.append(NorthSeen(name, float(wrap_pi(world.declination_rad + mean)), chance, steady, seconds))
    return found
