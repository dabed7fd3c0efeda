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
    correction = dialect.correction(parameters, instance)
    findings: list[Finding] = []
    if not is_calibrated(dialect.autopilot, parameters, instance, correction):
        findings.append(
            Finding(
                "uncalibrated",
                instance,
                "bad",
                f"Compass {instance} is not calibrated",
                f"The autopilot holds no calibration of compass {instance}.",
                "Calibrate it.",
            )
        )
    if last is None:
        return findings
    days = (now - datetime.fromisoformat(last.made_at)).total_seconds() / 86400.0
    if days > age_days:
        findings.append(
            Finding(
                "age",
                instance,
                "warning",
                f"Compass {instance}: calibrated {days:.0f} days ago",
                f"The calibration of compass {instance} is {days:.0f} days old.",
                "Calibrate it again.",
                days,
                age_days,
            )
        )
    changed = _changed(last, parameters, instance)
    if changed:
        differ = "differs" if len(changed) == 1 else "differ"
        findings.append(
            Finding(
                "parameters",
                instance,
                "warning",
                f"Compass {instance}: calibration was changed",
                f"{', '.join(changed)} of compass {instance} {differ} from what was calibrated"
                f" {last.made_at[:10]}.",
                "If that was not on purpose, put the calibration back or calibrate again.",
            )
        )
    return findings


def _changed(last: Entry, parameters: Mapping[str, float], instance: int) -> list[str]:
    """List the parameters that no longer hold what the last calibration left."""
    left: Mapping[str, float] = last.document.get("in_force", {}).get(str(instance), {})
    return [
        name
        for name, value in left.items()
        if name in parameters and abs(parameters[name] - value) > _SAME * max(1.0, abs(value))
    ]
