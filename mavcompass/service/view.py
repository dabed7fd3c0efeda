"""What the service knows of its vehicle, kept up to date message by message."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from mavcompass import messages as mav
from mavcompass.attitude import Level
from mavcompass.attitude.recorded import hear
from mavcompass.calibration.result import CalibrationResult
from mavcompass.compass_parameters import is_calibrated
from mavcompass.earth_field import EarthField
from mavcompass.heading.doubt import prior_sigma_rad
from mavcompass.heading.live import Agreement, Heading, LiveCompass
from mavcompass.kinds import Kind
from mavcompass.messages import telemetry
from mavcompass.procedure.vehicle_state import VehicleIdentity, VehicleState, kind_now
from mavcompass.service.watch import Glance
from mavcompass.steering import compasses_of
from mavcompass.vehicle.dialects import make_dialect

# Silence after which the vehicle counts as gone.
GONE_S = 2.0
# A clock that falls back by more than this was started again; less is a late message.
_REBOOT_S = 2.0
_PREFERRED_SILENCE_S = 1.0
_NEAR_1E7_DEG = 1_000_000  # a tenth of a degree, as GLOBAL_POSITION_INT counts


@dataclass(slots=True)
class VehicleView:
    """Keep the state of one vehicle; `hear` takes every message of it.

    Attributes:
        key: of its history. parameters: of its compasses, empty until they were read; `fresh` tells
            whether nothing has happened since that may have changed them.
        reconnects, reboots: counted since the service started.
        current_a: the latest battery current.
    """

    identity: VehicleIdentity
    key: str
    year: float
    state: VehicleState = field(default_factory=VehicleState)
    level: Level = field(init=False)
    compasses: dict[int, LiveCompass] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)
    fresh: bool = False
    world: EarthField | None = None
    heard_s: float = -math.inf
    boot_s: float = -math.inf
    reconnects: int = 0
    reboots: int = 0
    _agreement: Agreement = field(default_factory=Agreement)
    _preferred_s: float = -math.inf
    _world_at: mav.GlobalPositionInt | None = None

    def __post_init__(self) -> None:
        """Begin to keep its level."""
        self.level = Level(self.identity.kind)

    @property
    def kind(self) -> Kind:
        """Return what the vehicle is as it flies now."""
        return kind_now(self.identity.kind, self.state.landed)

    def is_from(self, heard: mav.Incoming) -> bool:
        """Tell whether the vehicle's autopilot said it."""
        return (heard.system, heard.component) == (self.identity.system, self.identity.component)

    def hear(self, heard: mav.Incoming) -> Heading | None:
        """Take one message; the heading, where it brought one."""
        message = heard.message
        self.heard_s = heard.time_s
        kind = type(message)
        if kind is mav.RawImu or kind is mav.ScaledImu:
            return self._body(heard.time_s, message)  # type: ignore[arg-type]
        if kind is mav.ScaledImu2 or kind is mav.ScaledImu3:
            return self._compass(3 if kind is mav.ScaledImu3 else 2, heard.time_s, message)  # type: ignore[arg-type]
        self.state.hear(heard)
        hear(self.level, message)
        if kind is mav.GlobalPositionInt:
            self._look_up_world(message)  # type: ignore[arg-type]
        elif kind is mav.GpsRawInt and self.kind != "vtol":  # which goes any way, while its rotors hold it
            for compass in self.compasses.values():
                compass.hear_receiver(message)  # type: ignore[arg-type]
        return None

    def _body(self, time_s: float, imu: mav.RawImu | mav.ScaledImu) -> Heading | None:
        """Take the first compass's message, in one of the two forms in which it comes."""
        if type(imu) is mav.RawImu:
            if self.identity.autopilot == "px4":
                return None  # its SCALED_IMU is the one whose numbers are known
            self._preferred_s = time_s
        elif time_s - self._preferred_s < _PREFERRED_SILENCE_S:
            return None  # RAW_IMU says the same, finer in time
        self.boot_s = telemetry.imu_time_s(imu)
        hear(self.level, imu)
        return self._compass(1, time_s, imu)

    def _compass(self, instance: int, time_s: float, imu: mav.RawImu | mav.ScaledImu) -> Heading | None:
        compass = self.compasses.get(instance)
        if compass is None:
            compass = self.compasses[instance] = LiveCompass(instance)
            compass.set_world(self.world)
            self._tell_correction(compass)
        field_mgauss = (float(imu.xmag), float(imu.ymag), float(imu.zmag))
        heading = compass.update(time_s, telemetry.imu_time_s(imu), field_mgauss, self.level)
        if heading is not None:
            self._agreement.hear(heading, self.compasses, self.level.rate_radps)
        return heading

    def restarted(self, message: mav.Message) -> bool:
        """Tell whether a message shows that the vehicle's clock began anew."""
        if not isinstance(message, mav.RawImu | mav.ScaledImu | mav.Attitude | mav.GlobalPositionInt):
            return False
        return bool(telemetry.imu_time_s(message) < self.boot_s - _REBOOT_S)

    def restart(self) -> None:
        """Forget what a reboot ends."""
        self.reboots += 1
        self.boot_s = -math.inf
        self.fresh = False
        self.level.restart()

    def _look_up_world(self, place: mav.GlobalPositionInt) -> None:
        """Look up the Earth's field; again after ten kilometres."""
        known = self._world_at
        if known is not None and max(abs(place.lat - known.lat), abs(place.lon - known.lon)) < _NEAR_1E7_DEG:
            return
        if (world := self.state.world(self.year)) is None:
            return
        self.world, self._world_at = world, place
        for compass in self.compasses.values():
            compass.set_world(self.world)

    # --- parameters ---------------------------------------------------------------------------------

    def set_parameters(self, parameters: Mapping[str, float]) -> None:
        """Take the compass parameters in force."""
        self.parameters, self.fresh = dict(parameters), True
        self._agreement.restart()
        for compass in self.compasses.values():
            compass.restart()
            self._tell_correction(compass)

    def _tell_correction(self, compass: LiveCompass) -> None:
        dialect, of = make_dialect(self.identity.autopilot), (self.parameters, compass.instance)
        if self.parameters and (rotation := dialect.raw_rotation(*of)) is not None:
            compass.set_uncorrected(dialect.correction(*of), rotation)

    def calibrated(self, results: Iterable[CalibrationResult]) -> None:
        """Take what was just written, so that the heading is told with the doubt of that from now on."""
        self._agreement.restart()
        for result in results:
            compass = self.compasses.get(result.instance)
            if compass is None or not result.accepted or result.already_right:
                continue
            compass.restart()
            self.set_calibration_sigma(result.instance, result.heading_sigma_deg)
            rotation = make_dialect(self.identity.autopilot).raw_rotation(self.parameters, result.instance)
            if rotation is not None and result.mounting.turned is None:
                compass.set_uncorrected(result.correction, rotation)

    def instances(self) -> tuple[int, ...]:
        """List the compasses that the vehicle has, by its parameters and by those heard."""
        reporting = [i for i, compass in self.compasses.items() if compass.latest is not None]
        return compasses_of(self.identity.autopilot, self.parameters, reporting)

    def device_id(self, instance: int) -> int:
        """Return a compass's device id, 0 where it is not known."""
        return make_dialect(self.identity.autopilot).device_ids(self.parameters)[instance - 1]

    def set_calibration_sigma(self, instance: int, sigma_deg: float | None) -> None:
        """Say how good the calibration in force is; None where that is not known."""
        compass = self.compasses.get(instance)
        if compass is not None:
            if sigma_deg is not None and math.isfinite(sigma_deg):
                compass.calibration_sigma_rad = math.radians(sigma_deg)
                return
            autopilot = self.identity.autopilot
            in_force = make_dialect(autopilot).correction(self.parameters, instance)
            calibrated = is_calibrated(autopilot, self.parameters, instance, in_force)
            compass.calibration_sigma_rad = prior_sigma_rad(calibrated)

    # --- for the watch ------------------------------------------------------------------------------

    @property
    def over_ground(self) -> tuple[float | None, float]:
        """Return course, true, radians, and speed, m/s, by the receiver; None and 0 where it tells none."""
        gps = self.state.gps
        north, east = (math.nan, math.nan) if gps is None else telemetry.ground_velocity_mps(gps)[:2].tolist()
        return (None, 0.0) if math.isnan(north) else (math.atan2(east, north), math.hypot(north, east))

    def glance(self, time_s: float) -> Glance:
        """Return what the watch looks at."""
        battery, (course_rad, speed_mps) = self.state.battery, self.over_ground
        measured = battery is not None and battery.current_battery >= 0
        return Glance(
            time_s=time_s,
            headings={i: c.latest for i, c in self.compasses.items() if c.latest is not None},
            world=self.world,
            rate_radps=self.level.rate_radps,
            bias_radps=self.level.bias_radps,
            stands=not self.state.armed and self.level.is_still,
            tilt_sigma_rad=self.level.sigma_rad,
            kind=self.kind,
            course_rad=course_rad,
            speed_mps=speed_mps,
            current_a=battery.current_battery * 0.01 if measured and battery is not None else None,
        )
