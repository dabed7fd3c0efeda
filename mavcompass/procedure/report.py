"""What a live calibration found and did."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.calibration.observation import latest_dwells
from mavcompass.calibration.result import CalibrationResult
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray, wrap_pi
from mavcompass.procedure.dialect import ParameterPlan, WriteOutcome
from mavcompass.procedure.nameplate import Nameplate
from mavcompass.procedure.positions import Proof, Window
from mavcompass.procedure.vehicle_state import VehicleIdentity
from mavcompass.track import Track

# An autopilot that steers further off than this is not done with.
RIGHT_DEG = 2.0


@dataclass(frozen=True, slots=True)
class AutopilotHeading:
    """Say how far the autopilot's own yaw was from the calibrated heading, and how it was brought there.

    Attributes:
        error_before_deg: at the start. error_after_deg: at the end; nan where it could not be told.
        by: what brought it there. seconds: from the write to the end.
        worst_deg: the largest error to expect in the minutes to come.
        wander_deg: by how much it may change by itself, 1 sigma; nan where that could not be told.
        set_aside: True where the autopilot follows no compass any more.
        not_loaded: True where the autopilot has not loaded the new calibration, and may lose it.
        flying: True where it is in the air.
        written: False where the values in force were left alone. flies: True for what does, when it does.
    """

    error_before_deg: float
    error_after_deg: float
    by: str
    seconds: float
    worst_deg: float
    wander_deg: float = 0.0
    set_aside: bool = False
    not_loaded: bool = False
    flying: bool = False
    written: bool = True
    flies: bool = False

    @property
    def known(self) -> bool:
        """Tell whether the error could be measured."""
        return math.isfinite(self.error_after_deg)

    @property
    def is_off(self) -> bool:
        """Tell whether the vehicle is known to steer by another heading than the calibrated one."""
        if not self.written:
            return self.known and abs(self.error_after_deg) > RIGHT_DEG
        worst_deg = self.worst_deg if math.isfinite(self.worst_deg) else abs(self.error_after_deg)
        may_wander = math.isnan(self.wander_deg)
        return self.not_loaded or (self.known and (may_wander or worst_deg > RIGHT_DEG))

    def summary(self) -> str:
        """Return the sentence for the person."""
        before_deg, after_deg = abs(self.error_before_deg), abs(self.error_after_deg)
        go = "flying" if self.flies else "driving"
        look = f"Compare it with a landmark before {go}."
        if self.not_loaded:
            off = f", {after_deg:.1f} deg off" if self.known else ""
            return (
                f"The autopilot still flies by the old calibration{off}: it loads the new one on the ground"
                " only, and stores what it learnt in flight over it when it is disarmed."
            )
        if not self.known:
            return f"The autopilot's own heading could not be measured. {look}"
        if not self.written:
            return (
                f"The autopilot's own heading is {after_deg:.1f} deg off.{f' {look}' if self.is_off else ''}"
            )
        if not self.is_off:
            return (
                f"The autopilot's own heading: {before_deg:.1f} deg off before, {after_deg:.1f} deg now"
                f" ({self.by})."
            )
        if after_deg <= RIGHT_DEG and self.wander_deg:
            wanders = f"may wander by {self.wander_deg:.1f} deg while it stands"
            stays = "does not stay there" if math.isnan(self.wander_deg) else wanders
            return f"The autopilot's own heading is {after_deg:.1f} deg off now, but {stays}. {look}"
        aside = " and has set its compasses aside" if self.set_aside else ""
        then = "Land, disarm and reboot before flying again" if self.flying else f"Reboot it before {go}"
        return f"The autopilot's own heading is still {after_deg:.1f} deg off{aside}. {then}."


def yaw_error_rad(
    track: Track,
    result: CalibrationResult,
    world: EarthField,
    start_s: float,
    end_s: float,
    turned: FloatArray | None = None,
) -> tuple[float, float, float]:
    """Return the autopilot's yaw less a calibrated compass's true heading at rest; that one's sigma; the yaw.

    The sigma is of noise, tilt and unrest over the stretch, not of the calibration. `turned` (3, 3) makes
    what was recorded what the compass reads as it is mounted.
    Raises PoorCalibration where the recording holds too little of either.
    """
    attitude = track.attitude_rad
    said = None if attitude is None else attitude.between(start_s, end_s)
    if said is None or not len(said):
        raise PoorCalibration("The autopilot did not tell its attitude.")
    (seen,) = latest_dwells(track, (result.instance,), start_s, end_s)
    if turned is not None:
        seen = replace(seen, mean_mgauss=turned @ seen.mean_mgauss)
    yaw = float(np.angle(np.exp(1j * said.values[:, 2]).mean()))
    sigma = seen.heading_sigma_rad(world.horizontal_mgauss, world.ned_mgauss[2])
    return float(wrap_pi(yaw - seen.heading_rad(result.correction) - world.declination_rad)), sigma, yaw


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationReport:
    """Say what a calibration found and did.

    Attributes:
        before: the correction in force at the start, per compass.
        proof: what the turn after the write showed; None where nothing was written.
        on_vehicle_s: from the first position to the end of the proof, by the vehicle's clock.
        undone: True where the proof failed and the old values were put back.
        heading: the autopilot's own heading after the write; None where nothing is written.
        vehicle: whose calibration it is.
    """

    identity: VehicleIdentity
    results: tuple[CalibrationResult, ...]
    before: Mapping[int, FieldCorrection]
    track: Track
    windows: tuple[Window, ...]
    duration_s: float
    plan: ParameterPlan | None = None
    outcome: WriteOutcome | None = None
    proof: Proof | None = None
    on_vehicle_s: float | None = None
    undone: bool = False
    heading: AutopilotHeading | None = None
    messages: tuple[str, ...] = ()
    vehicle: Nameplate | None = None

    @property
    def accepted(self) -> bool:
        """Tell whether every compass got a calibration worth writing."""
        return bool(self.results) and all(result.accepted for result in self.results)

    @property
    def to_write(self) -> tuple[CalibrationResult, ...]:
        """Return the results that are better than what is in force."""
        return tuple(result for result in self.results if not result.already_right)

    @property
    def written(self) -> bool:
        """Tell whether the new values are in force on the vehicle."""
        return self.outcome is not None and not self.undone

    @property
    def takes_effect_later(self) -> bool:
        """Tell whether some of the new values wait for the autopilot's next start."""
        return self.written and self.plan is not None and bool(self.plan.after_restart)

    @property
    def steers_off(self) -> bool:
        """Tell whether the autopilot still steers by another heading than the one that was written."""
        return self.written and self.heading is not None and self.heading.is_off

    def noting(self, *sentences: str) -> CalibrationReport:
        """Return the report with more to tell the person."""
        return replace(self, messages=(*self.messages, *sentences))
