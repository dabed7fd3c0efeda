"""The telemetry that all firmware shares: state turned into messages, in the wire's units."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from mavcompass import messages as m
from mavcompass.correction import Vector
from mavcompass.enums import MavAutopilot, MavModeFlag, MavState
from mavcompass.simulation.autopilot.board import Board, Status
from mavcompass.simulation.autopilot.compasses import Compasses
from mavcompass.simulation.autopilot.guidance import Radio
from mavcompass.units import MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS

_LANDED_ON_GROUND, _LANDED_IN_AIR = 1, 2
_TWO_PI = 2.0 * math.pi
_MILLI_G = 1.0 / MPS2_PER_MILLI_G
_MILLIRADPS = 1.0 / RADPS_PER_MILLIRADPS
# A GPS receiver's position error: slow, of this size.
_GPS_ERROR_M = 0.4


def int16(value: float) -> int:
    """Cast to int16 as C does: truncated toward zero, wrapped round on overflow; 0 for no number."""
    if not math.isfinite(value):
        return 0
    return (int(value) + 0x8000 & 0xFFFF) - 0x8000


def between(before: Vector, after: Vector, share: float) -> Vector:
    """Interpolate two vectors."""
    if share >= 1.0:
        return after
    return (
        before[0] + share * (after[0] - before[0]),
        before[1] + share * (after[1] - before[1]),
        before[2] + share * (after[2] - before[2]),
    )


Builder = Callable[[int, float], m.Message | None]


@dataclass(frozen=True, slots=True)
class Battery:
    """Describe a battery: its voltages when full and when empty, what a load takes off, its capacity."""

    full_volts: float
    low_volts: float
    volts_per_amp: float
    low_percent: int


class Reports(ABC):
    """Build messages from the state of a vehicle; times are since its boot.

    Attributes:
        unused_channel: what RC_CHANNELS says of channels that are not there. capabilities, version: as in
            AUTOPILOT_VERSION.
        builders: what this firmware can build; a builder gets the time in microseconds and how far it lies
            between the last two ticks. A subclass adds its own and what it builds otherwise.
    """

    autopilot: MavAutopilot
    battery: Battery
    unused_channel: int
    capabilities: int
    version: int

    def __init__(self, board: Board, status: Status, compasses: Compasses, radio: Radio) -> None:
        self.board = board
        self.status = status
        self.compasses = compasses
        self.radio = radio
        self.builders: dict[type[m.Message], Builder] = {
            m.Attitude: self.attitude,
            m.Heartbeat: lambda t, s: self.heartbeat(),
            m.SysStatus: lambda t, s: self.sys_status(),
            m.SystemTime: lambda t, s: self.system_time(t),
            m.GpsRawInt: lambda t, s: self.gps(t),
            m.ScaledPressure: lambda t, s: self.scaled_pressure(t),
            m.LocalPositionNed: lambda t, s: self.local_position(t),
            m.GlobalPositionInt: lambda t, s: self.global_position(t),
            m.ServoOutputRaw: lambda t, s: self.servos(t),
            m.RcChannels: lambda t, s: self.rc_channels(t),
            m.VfrHud: lambda t, s: self.vfr_hud(),
            m.ExtendedSysState: lambda t, s: self.extended_state(),
            m.AutopilotVersion: lambda t, s: self.autopilot_version(),
        }

    def autopilot_version(self) -> m.AutopilotVersion:
        """Tell the firmware's version and the board's serial number."""
        return m.AutopilotVersion(self.capabilities, self.version, uid=self.board.uid)

    @property
    def kinds(self) -> frozenset[type[m.Message]]:
        """Return the messages that this firmware can build."""
        return frozenset(self.builders)

    def build(self, kind: type[m.Message], time_us: int, share: float) -> m.Message | None:
        """Build one message; None where this vehicle has nothing to say."""
        return self.builders[kind](time_us, share)

    @abstractmethod
    def default_intervals(self) -> Mapping[int, int]:
        """Return message id -> interval in microseconds of what a port sends unasked."""

    @abstractmethod
    def mode_numbers(self) -> tuple[MavModeFlag, int]:
        """Return HEARTBEAT's base_mode and custom_mode."""

    @abstractmethod
    def active(self) -> bool:
        """Tell whether the heartbeat calls the vehicle ACTIVE rather than STANDBY."""

    @abstractmethod
    def sensors_present_and_healthy(self) -> tuple[int, int]:
        """Return SYS_STATUS's bits."""

    @property
    @abstractmethod
    def capacity_mah(self) -> float:
        """Return the battery's capacity."""

    def heartbeat(self) -> m.Heartbeat:
        """Describe the vehicle."""
        base_mode, custom_mode = self.mode_numbers()
        state = MavState.ACTIVE if self.active() else MavState.STANDBY
        return m.Heartbeat(
            type=self.board.profile.mav_type,
            autopilot=self.autopilot,
            base_mode=base_mode,
            custom_mode=custom_mode,
            system_status=MavState.CRITICAL if self.status.failsafe else state,
        )

    def sys_status(self) -> m.SysStatus:
        """Report the sensors' health and the battery."""
        present, healthy = self.sensors_present_and_healthy()
        left = int(100.0 * (1.0 - self.board.consumed_mah / self.capacity_mah))
        return m.SysStatus(
            onboard_control_sensors_present=present,
            onboard_control_sensors_enabled=present,
            onboard_control_sensors_health=healthy,
            voltage_battery=int(1000.0 * self.battery_volts()),
            current_battery=int(100.0 * self.board.surroundings().current_a),
            battery_remaining=max(0, min(left, self.battery.low_percent if self.status.battery_low else 100)),
        )

    def battery_volts(self) -> float:
        """Return the battery's voltage under the present load."""
        unloaded = self.battery.low_volts if self.status.battery_low else self.battery.full_volts
        return unloaded - self.battery.volts_per_amp * self.board.surroundings().current_a

    def extended_state(self) -> m.ExtendedSysState:
        """Report whether it flies."""
        landed = _LANDED_ON_GROUND if self.board.body.landed else _LANDED_IN_AIR
        return m.ExtendedSysState(self.board.profile.vtol_state, landed)

    def servos(self, time_us: int) -> m.ServoOutputRaw:
        """Report the motors' outputs: those of four rotors, or of a left and a right wheel."""
        board, body, profile = self.board, self.board.body, self.board.profile
        if profile.hovers:
            pwm = [int(1000 + 1000 * output) for output in board.surroundings().motors]
        else:
            ahead = body.speed_mps / profile.speed_max_mps
            turn = body.yaw_rate_radps / profile.yaw_rate_max_radps
            pwm = [int(1500 + 400 * (ahead + turn)), 0, int(1500 + 400 * (ahead - turn)), 0]
        return m.ServoOutputRaw(self.boot_us(time_us) & 0xFFFFFFFF, 0, *pwm)

    def rc_channels(self, time_us: int) -> m.RcChannels:
        """Report the sticks."""
        channels = self.radio.channels(self.board.boot_time_s)
        unused = (self.unused_channel,) * (18 - len(channels))
        return m.RcChannels(self.boot_us(time_us) // 1000, len(channels), *channels, *unused)

    def boot_us(self, time_us: int) -> int:
        """Return microseconds since boot at a simulation time."""
        return time_us - self.board.boot_us

    def imu(self, index: int, share: float) -> tuple[int, int, int, int, int, int]:
        """Return acceleration in milli-g and rate in mrad/s of IMU 0 or 1, truncated."""
        sensors = self.board.sensors
        now = sensors.samples[index]
        before = sensors.previous[index]
        ax, ay, az = between(before.acc_mps2, now.acc_mps2, share)
        gx, gy, gz = between(before.gyro_radps, now.gyro_radps, share)
        return (
            int16(ax * _MILLI_G),
            int16(ay * _MILLI_G),
            int16(az * _MILLI_G),
            int16(gx * _MILLIRADPS),
            int16(gy * _MILLIRADPS),
            int16(gz * _MILLIRADPS),
        )

    def scaled_imu(
        self, time_us: int, share: float, index: int, field: Vector, temperature: int
    ) -> tuple[int, ...]:
        """Return the values of SCALED_IMU and its like, in their order."""
        x, y, z = field
        imu = self.imu(index, share)
        return self.boot_us(time_us) // 1000, *imu, int16(x), int16(y), int16(z), temperature

    def temperature_cdegc(self) -> int:
        """Return the IMU's temperature in hundredths of a degree."""
        return int(self.board.surroundings().temperature_degc * 100.0)

    def attitude(self, time_us: int, share: float) -> m.Attitude:
        """Report the filter's attitude."""
        f = self.board.filter
        p, q, r = f.rate_radps
        yaw = f.yaw_rad - r * self.back_s(share)
        return m.Attitude(self.boot_us(time_us) // 1000, f.roll_rad, f.pitch_rad, yaw, p, q, r)

    def global_position(self, time_us: int) -> m.GlobalPositionInt:
        """Report the filter's position and heading."""
        b = self.board.body
        lat, lon, alt = self.place()
        n, e, d = (int(v * 100.0) for v in b.velocity_ned_mps)
        above = int(b.height_m * 1000.0)
        return m.GlobalPositionInt(
            self.boot_us(time_us) // 1000, lat, lon, alt, above, n, e, d, self.heading_cdeg()
        )

    def local_position(self, time_us: int) -> m.LocalPositionNed | None:
        """Report the position relative to the start, once it is known."""
        if not self.board.ready:
            return None
        b = self.board.body
        n, e, d = b.velocity_ned_mps
        ms = self.boot_us(time_us) // 1000
        return m.LocalPositionNed(ms, b.north_m, b.east_m, -b.height_m, n, e, d)

    def gps(self, time_us: int) -> m.GpsRawInt:
        """Report the receiver: no fix in the first third of the time to readiness."""
        v = self.board
        if v.boot_time_s < v.ready_s / 3.0:
            return m.GpsRawInt(self.boot_us(time_us), fix_type=1, satellites_visible=3)
        phase = _TWO_PI * v.boot_time_s / 400.0 + v.seed
        lat, lon, alt = self.place(_GPS_ERROR_M * math.cos(phase), _GPS_ERROR_M * math.sin(phase))
        n, e, _ = v.body.velocity_ned_mps
        return m.GpsRawInt(
            time_usec=self.boot_us(time_us),
            fix_type=6,
            lat=lat,
            lon=lon,
            alt=alt,
            eph=121,
            epv=200,
            vel=int(math.hypot(n, e) * 100.0),
            cog=int(math.degrees(math.atan2(e, n)) % 360.0 * 100.0),
            satellites_visible=10,
        )

    def vfr_hud(self) -> m.VfrHud:
        """Report what a pilot looks at."""
        v = self.board
        n, e, d = v.body.velocity_ned_mps
        speed = math.hypot(n, e)
        throttle = int(100.0 * v.surroundings().throttle)
        altitude = v.world.place.alt_m + v.body.height_m
        return m.VfrHud(speed, speed, self.heading_cdeg() // 100, throttle, altitude, -d)

    def heading_cdeg(self) -> int:
        """Return the filter's heading, 0..35999 hundredths of a degree."""
        return int(math.degrees(self.board.filter.yaw_rad) % 360.0 * 100.0) % 36000

    def system_time(self, time_us: int) -> m.SystemTime:
        """Report the clock: UTC from GPS, and since boot."""
        utc_us = round(self.board.world.utc_start_s * 1e6) + time_us
        known = self.board.boot_time_s >= self.board.ready_s / 3.0
        return m.SystemTime(utc_us if known else 0, self.boot_us(time_us) // 1000)

    def scaled_pressure(self, time_us: int) -> m.ScaledPressure:
        """Report the barometer (11.9 Pa per metre near the ground)."""
        height = self.board.world.place.alt_m + self.board.body.height_m
        pressure = 1013.25 * (1.0 - 2.25577e-5 * height) ** 5.25588
        return m.ScaledPressure(self.boot_us(time_us) // 1000, pressure, 0.0, self.temperature_cdegc())

    def back_s(self, share: float) -> float:
        """Return how long ago, before the last tick, a message's moment lies."""
        return (1.0 - share) * self.board.tick_us * 1e-6

    def place(self, north_error_m: float = 0.0, east_error_m: float = 0.0) -> tuple[int, int, int]:
        """Return latitude and longitude in 1e-7 degrees and altitude in millimetres, so far off."""
        b = self.board.body
        p = self.board.world.position_to_place(
            b.north_m + north_error_m, b.east_m + east_error_m, -b.height_m
        )
        return int(p.lat_deg * 1e7), int(p.lon_deg * 1e7), int(p.alt_m * 1e3)
