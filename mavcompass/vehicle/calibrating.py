"""Run the calibration procedure on a link: the one place that puts its parts together."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from mavcompass.calibration import calibrate_compasses
from mavcompass.calibration.result import CalibrationResult, Limits
from mavcompass.earth_field import EarthField
from mavcompass.procedure.calibrate import Found, Services, Solve, calibrate
from mavcompass.procedure.positions import Window
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Ask, Machine, Show
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.track import Track
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.driver import PollAnswer, run
from mavcompass.vehicle.link import Link
from mavcompass.vehicle.parameters.undo import cut_short, undo_saver
from mavcompass.vehicle.stopping import StopRequest


def calibrate_on(
    link: Link,
    source: str,
    settings: CalibrateSettings,
    *,
    on_show: Callable[[Show], None] | None = None,
    on_ask: Callable[[Ask], PollAnswer] | None = None,
    stop: StopRequest | None = None,
    undo_directory: Path | None = None,
) -> CalibrationReport:
    """Calibrate the vehicle on a link and return what was found and done.

    `source` is the address as the person gave it: it goes into the undo record and its command.
    Raises what `procedure.calibrate.calibrate` and `driver.run` raise.
    """
    machine = calibration_machine(source, settings, undo_directory)
    return run(machine, link, on_show=on_show, on_ask=on_ask, stop=stop)


def solve(
    track: Track,
    instances: tuple[int, ...],
    windows: list[Window],
    earth: EarthField | None,
    settings: CalibrateSettings,
    found: Found,
) -> tuple[CalibrationResult, ...]:
    """Solve and judge compasses on the positions that a procedure visited."""
    results = calibrate_compasses(
        track,
        settings.solver,
        instances,
        earth=earth,
        windows=None if settings.by_autopilot else [(window.start_s, window.end_s) for window in windows],
        limits=Limits(heading_deg=settings.max_heading_error_deg),
        true_heading=settings.true_heading,
        found=found,
    )
    return tuple(results.values())


def calibration_machine(
    source: str,
    settings: CalibrateSettings,
    undo_directory: Path | None = None,
    solve: Solve = solve,
    utc_now: Callable[[], datetime] = lambda: datetime.now(UTC),
) -> Machine[CalibrationReport]:
    """Build the machine, for those who drive it themselves, or have it solved elsewhere."""
    services = Services(
        dialect_for=lambda autopilot: make_dialect(autopilot, source),
        save_undo=undo_saver(source, undo_directory, utc_now),
        solve=solve,
        cut_short=cut_short(undo_directory),
    )
    return Machine(lambda context: calibrate(context, services, settings))
