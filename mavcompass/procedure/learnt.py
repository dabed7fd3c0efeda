"""Write what was learnt while the vehicle worked: nothing moves; the same plan, transaction and undo."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mavcompass import messages as mav
from mavcompass.calibration.result import CalibrationResult, summary
from mavcompass.correction import FieldCorrection
from mavcompass.errors import Refused
from mavcompass.procedure.autopilot_heading import OwnHeading
from mavcompass.procedure.commands import MessageRates
from mavcompass.procedure.desk import Desk
from mavcompass.procedure.dialect import Dialect, Overrides, ParameterPlan, SaveUndo
from mavcompass.procedure.nameplate import Nameplate
from mavcompass.procedure.report import CalibrationReport
from mavcompass.procedure.script import Context, Script, expect, pause
from mavcompass.procedure.settings import CalibrateSettings
from mavcompass.procedure.writing import Writer

# A heading is compared with the autopilot's over so long a rest; who does not rest is not waited for.
_REST_S, _REST_WITHIN_S = 1.5, 6.0
# Parameters travel as 32 bit floats.
_SAME = 1e-3


def write_learnt(
    context: Context,
    dialect_for: Callable[[str], Dialect],
    save_undo: SaveUndo,
    results: Sequence[CalibrationResult],
    settings: CalibrateSettings,
) -> Script[CalibrationReport]:
    """Write results that were found beforehand, with consent, into a vehicle that is disarmed.

    Of the settings `writing`, `system`, `rate_hz` and `year` are heeded.
    Raises Refused where it is armed, or another calibration is in force than the one they improve;
    LinkError where it cannot be heard; WriteFailed where values were left half written.
    """
    desk = yield from Desk.open(context, dialect_for, settings.system)
    if desk.state.heartbeat is None:
        yield from expect(context, mav.Heartbeat, timeout_s=3.0)
    _refuse_armed(desk)
    for result in results:
        if not _same(desk.dialect.correction(desk.parameters, result.instance), result.in_force):
            raise Refused(
                f"The calibration of compass {result.instance} was changed since this was learnt.",
                "Drive or fly on: it is learnt anew.",
            )
        context.show("solve", summary(result), 0.3)

    def save_if_disarmed(plan: ParameterPlan, values: Mapping[str, float], vehicle: Nameplate) -> Path:
        _refuse_armed(desk)  # the answer may have taken a while
        return save_undo(plan, values, vehicle)

    overrides = Overrides(desk.dialect, save_if_disarmed)
    rates, own = MessageRates(), OwnHeading(desk, settings.year, overrides)
    report = CalibrationReport(
        identity=desk.identity,
        results=tuple(results),
        before={result.instance: result.in_force for result in results},
        track=desk.builder.build(),
        windows=(),
        duration_s=0.0,
        vehicle=desk.vehicle,
    )
    if settings.writing == "never":
        return report
    try:
        wanted = desk.imu_rates(tuple(result.instance for result in results), settings.rate_hz)
        wanted |= {
            mav.Attitude: 10.0,
            mav.EkfStatusReport: 2.0,
            mav.SystemTime: 2.0,
            mav.GlobalPositionInt: 4.0,
        }
        yield from rates.ask(context, wanted)
        report = yield from Writer(desk, save_if_disarmed, settings.writing == "ask").write(report)
        if report.outcome is not None and (yield from _rested(desk)):
            now_s = desk.rest.time_s
            own.found(results, [(now_s - _REST_S, now_s)])
            yield from own.written(report.outcome.values)
            yield from own.settle()
            report = replace(report, heading=own.outcome())
        return replace(report, track=desk.builder.build(), duration_s=desk.duration_s())
    finally:
        yield from rates.restore(context)


def _refuse_armed(desk: Desk) -> None:
    if desk.state.armed:
        raise Refused(
            "The vehicle is armed: what was learnt is written on the ground only.",
            "Disarm it, then ask again.",
        )


def _same(one: FieldCorrection, other: FieldCorrection) -> bool:
    numbers = [np.concatenate([np.asarray(c.offsets_mgauss), c.matrix.ravel()]) for c in (one, other)]
    return bool(np.allclose(numbers[0], numbers[1], rtol=_SAME, atol=_SAME))


def _rested(desk: Desk) -> Script[bool]:
    """Wait until the vehicle has rested long enough to compare headings; False where it does not rest."""
    end_s = desk.context.now + _REST_WITHIN_S
    while desk.rest.for_s() < _REST_S and desk.context.now < end_s:
        yield from pause(desk.context, 0.2)
    return desk.rest.for_s() >= _REST_S
