"""What a procedure on a live vehicle works with, from the first heartbeat on."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from mavcompass import messages as mav
from mavcompass.calibration.observation import WHEELED, latest_dwells
from mavcompass.earth_field import earth_field_of
from mavcompass.errors import PoorCalibration, Refused
from mavcompass.kinds import HOVERING
from mavcompass.procedure.dialect import Dialect, describe_compasses
from mavcompass.procedure.nameplate import Nameplate
from mavcompass.procedure.positions import Rest
from mavcompass.procedure.script import Context, Script, expect
from mavcompass.procedure.turning import GyroAngle
from mavcompass.procedure.vehicle_state import VehicleIdentity, VehicleState, find_vehicle
from mavcompass.track_builder import TrackBuilder

# Of a compass without an id only its readings tell; what streams at all does so twice in this time.
_FIRST_READING_S = 2.0
# A compass that is only a witness is averaged over the same stretches.
_WITNESS_HZ = 10.0
# The Earth's horizontal and vertical field in temperate latitudes, where the place is not known.
_TYPICAL_MGAUSS = (220.0, 430.0)


@dataclass(slots=True)
class Desk:
    """Hold who the vehicle is, its parameters, and what it says: its state, its turning, its recording.

    Attributes:
        parameters: in force when the desk was opened.
        builder: records from then on.
        began_s: when the desk began to wait for the vehicle.
        vehicle: which one it is; None in a test without one.
    """

    context: Context
    identity: VehicleIdentity
    dialect: Dialect
    parameters: dict[str, float]
    state: VehicleState
    builder: TrackBuilder
    began_s: float
    gyro: GyroAngle = field(default_factory=GyroAngle)
    rest: Rest = field(default_factory=Rest)
    vehicle: Nameplate | None = None

    @classmethod
    def open(
        cls, context: Context, dialect_for: Callable[[str], Dialect], system: int | None
    ) -> Script[Desk]:
        """Find the vehicle, read its parameters, hold it, start recording.

        Raises LinkError where it is not heard, Refused where another program works on it.
        """
        began_s = context.now
        context.show("connect", "Waiting for the vehicle's heartbeat.", 0.0)
        identity = yield from find_vehicle(context, system)
        # Only now: before, every vehicle on the link is heard.
        state = VehicleState()
        context.listeners.append(state.hear)
        context.show("connect", f"Found {identity}.")
        dialect = dialect_for(identity.autopilot)
        parameters = yield from dialect.compass_parameters(context)
        vehicle = yield from dialect.claim(context, parameters)
        builder = TrackBuilder(identity.autopilot, identity.kind)
        builder.parameters.update(parameters)
        describe_compasses(builder, dialect, parameters)
        if not dialect.instances(parameters, state.reporting):
            yield from expect(context, mav.RawImu, timeout_s=_FIRST_READING_S)
        rest = Rest(wheels=identity.kind in WHEELED)
        desk = cls(
            context, identity, dialect, parameters, state, builder, began_s, rest=rest, vehicle=vehicle
        )
        context.listeners += [builder.add, desk.gyro.hear, desk.rest.hear]
        return desk

    def now_in_force(self, values: Mapping[str, float]) -> None:
        """Take note of parameters that were written since the desk was opened."""
        if values:
            self.parameters |= values
            self.builder.parameters.update(self.parameters)
            describe_compasses(self.builder, self.dialect, self.parameters)

    @property
    def instances(self) -> tuple[int, ...]:
        """List the vehicle's compasses, from 1."""
        return self.dialect.instances(self.parameters, self.state.reporting)

    def chosen(self, wanted: tuple[int, ...]) -> tuple[int, ...]:
        """Return the compasses to work on, all where none is named.

        Raises Refused for a missing one.
        """
        present = self.instances
        missing = [str(i) for i in wanted if i not in present]
        if missing:
            raise Refused(
                f"The vehicle has no compass {', '.join(missing)}; it has {len(present) or 'none'}.",
                "Choose with --compass, or connect and enable the compass.",
            )
        return wanted or present

    def imu_rates(self, instances: tuple[int, ...], rate_hz: float) -> dict[type[mav.Message], float]:
        """List the messages that carry these compasses; the first one's brings the gyro along."""
        kinds = carriers(self.identity.autopilot)
        return {kinds[i]: rate_hz for i in sorted({1, *instances}) if i in kinds}

    def calibration_rates(self, instances: tuple[int, ...], rate_hz: float) -> dict[type[mav.Message], float]:
        """List the messages that a calibration needs: fast ones for the readings, slow ones for safety."""
        identity, wanted = self.identity, self.imu_rates(instances, rate_hz)
        first = next(iter(wanted))
        # The other compasses are witnesses.
        wanted |= {
            kind: min(rate_hz, _WITNESS_HZ)
            for kind in self.imu_rates(self.instances, rate_hz)
            if kind not in wanted
        }
        wanted[mav.Attitude] = min(rate_hz, 10.0)
        # The mode and the arming are told by heartbeats only: one a second is late for ending a motion.
        wanted |= dict.fromkeys((mav.GlobalPositionInt, mav.RcChannels, mav.SysStatus, mav.Heartbeat), 4.0)
        # A second antenna tells a witness's heading.
        wanted |= dict.fromkeys((mav.EkfStatusReport, mav.SystemTime, mav.GpsRawInt), 2.0)
        if identity.kind in HOVERING:
            # What hovers sways and shakes: its tilt is told by the receiver's velocity and by as many
            # readings as there are, see `attitude.level`.
            wanted[mav.GpsRawInt] = 5.0
            wanted[first] = 2.0 * rate_hz
        if identity.autopilot == "px4":
            del wanted[mav.EkfStatusReport]
            wanted[mav.LocalPositionNed] = 4.0
            # SCALED_IMU is one reading of 5 ms, not a mean: the more of them, the less noise.
            wanted[first] = 4.0 * rate_hz
        return wanted

    def sureness_deg(self, instances: tuple[int, ...], start_s: float, end_s: float, year: float) -> float:
        """Return how far the heading by one still stretch may be off, 1 sigma, of the worst of compasses."""
        track = self.builder.build()
        try:
            seen = latest_dwells(track, instances, start_s, end_s)
        except (PoorCalibration, KeyError):
            return math.inf
        world = earth_field_of(track, year)
        across, down = _TYPICAL_MGAUSS if world is None else (world.horizontal_mgauss, world.ned_mgauss[2])
        return max(math.degrees(dwell.heading_sigma_rad(across, down)) for dwell in seen)

    def duration_s(self) -> float:
        """Return how long the desk has been open."""
        return self.context.now - self.began_s


def carriers(autopilot: str) -> dict[int, type[mav.Message]]:
    """Return the message that carries each compass, from 1; MAVLink has none for a fourth."""
    first = mav.ScaledImu if autopilot == "px4" else mav.RawImu
    return {1: first, 2: mav.ScaledImu2, 3: mav.ScaledImu3}
