"""Compare what is in force on the vehicle with what the history says was calibrated, and when."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime

from mavcompass.compass_parameters import is_calibrated
from mavcompass.procedure.dialect import Dialect
from mavcompass.service.watch import Finding
from mavcompass.service.work.history import Entry

_SAME = 1e-3  # relative: parameters travel as 32 bit floats


def stale_findings(
    instance: int,
    dialect: Dialect,
    parameters: Mapping[str, float],
    last: Entry | None,
    now: datetime,
    age_days: float,
) -> list[Finding]:
    """List why the calibration in force on one compass is not, or no longer, what was calibrated."""
    i, findings = instance, list[Finding]()
    if not is_calibrated(dialect.autopilot, parameters, i, dialect.correction(parameters, i)):
        text = f"The autopilot holds no calibration of compass {i}."
        findings.append(
            Finding("uncalibrated", i, "bad", f"Compass {i} is not calibrated", text, "Calibrate it.")
        )
    if last is None:
        return findings
    days = (now - datetime.fromisoformat(last.made_at)).total_seconds() / 86400.0
    if days > age_days:
        short = f"Compass {i}: calibrated {days:.0f} days ago"
        text = f"The calibration of compass {i} is {days:.0f} days old."
        findings.append(Finding("age", i, "warning", short, text, "Calibrate it again.", days, age_days))
    if changed := _changed(last, parameters, i):
        differ = "differs" if len(changed) == 1 else "differ"
        text = f"{', '.join(changed)} of compass {i} {differ} from what was calibrated {last.made_at[:10]}."
        remedy = "If that was not on purpose, put the calibration back or calibrate again."
        short = f"Compass {i}: calibration was changed"
        findings.append(Finding("parameters", i, "warning", short, text, remedy))
    return findings


def _changed(last: Entry, parameters: Mapping[str, float], instance: int) -> list[str]:
    """List the parameters that no longer hold what the last calibration left."""
    left: Mapping[str, float] = last.document.get("in_force", {}).get(str(instance), {})
    return [
        name
        for name, value in left.items()
        if name in parameters and abs(parameters[name] - value) > _SAME * max(1.0, abs(value))
    ]
