"""The telemetry that both firmwares share: state turned into messages, in the wire's units."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from mavcompass import messages as m
from mavcompass.correction import Vector
from mavcompass.enums import EkfFlag
from mavcompass.units import MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS

if TYPE_CHECKING:
    from mavcompass.simulation.physics.sensors import ImuSample
    from mavcompass.simulation.vehicle import SimulatedAutopilot

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


class Reports:
    """Build messages from the state of a vehicle; times are since its boot."""

    def __init__(self, vehicle: SimulatedAutopilot) -> None:
        self.vehicle = vehicle

    def boot_us(self, time_us: int) -> int:
        """Return microseconds since boot at a simulation time."""
        return time_us - self.vehicle.boot_us

    def imu(self, index: int, share: float) -> tuple[int, int, int, int, int, int]:
        """Return acceleration in milli-g and rate in mrad/s of IMU 0 or 1, truncated."""
        sensors = self.vehicle.sensors
        now: ImuSample = sensors.samples[index]
        before: ImuSample = sensors.previous[index]
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

    def temperature_cdegc(self) -> int:
        """Return the IMU's temperature in hundredths of a degree."""
        return int(self.vehicle.surroundings().temperature_degc * 100.0)

    def attitude(self, time_us: int, share: float) -> m.Attitude:
        """Report the filter's attitude."""
        f = self.vehicle.filter
        p, q, r = f.rate_radps
        yaw = f.yaw_rad - r * self._back_s(share)
        return m.Attitude(self.boot_us(time_us) // 1000, f.roll_rad, f.pitch_rad, yaw, p, q, r)

    def simstate(self, share: float) -> m.Simstate:
        """Report the truth, as simulations do."""
        b = self.vehicle.body
        yaw = b.yaw_rad - b.yaw_rate_radps * self._back_s(share)
        lat, lon, _ = self._place(0.0, 0.0)
        (x, y, z), (p, q, r) = b.specific_force_mps2, b.rate_radps
        return m.Simstate(b.roll_rad, b.pitch_rad, yaw, x, y, z, p, q, r, lat, lon)

    def global_position(self, time_us: int) -> m.GlobalPositionInt:
        """Report the filter's position and heading."""
        b = self.vehicle.body
        lat, lon, alt = self._place(0.0, 0.0)
        n, e, d = (int(v * 100.0) for v in b.velocity_ned_mps)
        above = int(b.height_m * 1000.0)
        return m.GlobalPositionInt(
            self.boot_us(time_us) // 1000, lat, lon, alt, above, n, e, d, self.heading_cdeg()
        )

    def local_position(self, time_us: int) -> m.LocalPositionNed | None:
        """Report the position relative to the start, once it is known."""
        if not self.vehicle.ready:
            return None
        b = self.vehicle.body
        n, e, d = b.velocity_ned_mps
        ms = self.boot_us(time_us) // 1000
        return m.LocalPositionNed(ms, b.north_m, b.east_m, -b.height_m, n, e, d)

    def gps(self, time_us: int) -> m.GpsRawInt:
        """Report the receiver: no fix in the first third of the time to readiness."""
        v = self.vehicle
        if v.boot_time_s < v.ready_s / 3.0:
            return m.GpsRawInt(self.boot_us(time_us), fix_type=1, satellites_visible=3)
        phase = _TWO_PI * v.boot_time_s / 400.0 + v.seed
        lat, lon, alt = self._place(_GPS_ERROR_M * math.cos(phase), _GPS_ERROR_M * math.sin(phase))
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
        v = self.vehicle
        n, e, d = v.body.velocity_ned_mps
        speed = math.hypot(n, e)
        throttle = int(100.0 * v.surroundings().throttle)
        altitude = v.world.place.alt_m + v.body.height_m
        return m.VfrHud(speed, speed, self.heading_cdeg() // 100, throttle, altitude, -d)

    def heading_cdeg(self) -> int:
        """Return the filter's heading, 0..35999 hundredths of a degree."""
        return int(math.degrees(self.vehicle.filter.yaw_rad) % 360.0 * 100.0) % 36000

    def system_time(self, time_us: int) -> m.SystemTime:
        """Report the clock: UTC from GPS, and since boot."""
        utc_us = round(self.vehicle.world.utc_start_s * 1e6) + time_us
        known = self.vehicle.boot_time_s >= self.vehicle.ready_s / 3.0
        return m.SystemTime(utc_us if known else 0, self.boot_us(time_us) // 1000)

    def ekf_status(self) -> m.EkfStatusReport:
        """Report the filter's health."""
        ready = self.vehicle.ready
        flags = EkfFlag.ATTITUDE | EkfFlag.VELOCITY_HORIZ | EkfFlag.VELOCITY_VERT | EkfFlag.POS_VERT_ABS
        # Bits 8 and 9: predicted positions are good; GPS quality allows.
        position = EkfFlag.POS_HORIZ_REL | EkfFlag.POS_HORIZ_ABS | 0x300
        flags |= position if ready else EkfFlag.CONST_POS_MODE
        return m.EkfStatusReport(int(flags), 0.007, 0.008, 0.007, self.vehicle.filter.compass_variance)

    def scaled_pressure(self, time_us: int) -> m.ScaledPressure:
        """Report the barometer (11.9 Pa per metre near the ground)."""
        height = self.vehicle.world.place.alt_m + self.vehicle.body.height_m
        pressure = 1013.25 * (1.0 - 2.25577e-5 * height) ** 5.25588
        return m.ScaledPressure(self.boot_us(time_us) // 1000, pressure, 0.0, self.temperature_cdegc())

    def _back_s(self, share: float) -> float:
        """Return how long ago, before the last tick, a message's moment lies."""
        return (1.0 - share) * self.vehicle.tick_us * 1e-6

    def _place(self, north_error_m: float, east_error_m: float) -> tuple[int, int, int]:
        b = self.vehicle.body
        p = self.vehicle.world.position_to_place(
            b.north_m + north_error_m, b.east_m + east_error_m, -b.height_m
        )
        return int(p.lat_deg * 1e7), int(p.lon_deg * 1e7), int(p.alt_m * 1e3)
