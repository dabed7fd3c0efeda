"""ArduPilot's telemetry: what its fields really carry, which is not always what their names say."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from mavcompass import messages as m
from mavcompass.correction import Vector
from mavcompass.simulation.ardupilot.arming import arming_refusals
from mavcompass.simulation.autopilot.reports import Reports, int16
from mavcompass.units import MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS

if TYPE_CHECKING:
    from mavcompass.simulation.ardupilot.firmware import ArduPilot

Builder = Callable[[int, float], m.Message | None]

_SENSOR_BITS = 322034735
_SENSOR_MAG, _SENSOR_PREARM = 1 << 2, 1 << 28
# 4.6.3, an official release.
_VERSION = 4 << 24 | 6 << 16 | 3 << 8 | 255
# MISSION_INT, COMMAND_INT, PARAM_ENCODE_C_CAST, SET_ATTITUDE_TARGET, SET_POSITION_TARGET_LOCAL_NED,
# MAVLINK2, COMPASS_CALIBRATION.
_CAPABILITIES = 1 << 2 | 1 << 3 | 1 << 17 | 1 << 6 | 1 << 7 | 1 << 13 | 1 << 12
_LANDED_ON_GROUND, _LANDED_IN_AIR = 1, 2
_FULL_VOLTS, _VOLTS_PER_AMP, _LOW_VOLTS = 12.6, 0.01, 10.4
_CAPACITY_MAH = 3300.0
# The simulated firmware's HIGHRES_IMU carries a thousand times milligauss where gauss are due.
_HIGHRES_MAG_FACTOR = 1000.0


class ArduPilotReports(Reports):
    """Build ArduPilot's messages."""

    def __init__(self, firmware: ArduPilot) -> None:
        super().__init__(firmware.vehicle)
        self._fc = firmware
        self._builders: dict[type[m.Message], Builder] = {
            m.RawImu: self._raw_imu,
            m.ScaledImu: self._scaled_imu,
            m.ScaledImu2: self._scaled_imu2,
            m.ScaledImu3: self._scaled_imu3,
            m.HighresImu: self._highres_imu,
            m.Attitude: self.attitude,
            m.Heartbeat: lambda t, s: self._fc.heartbeat(),
            m.SysStatus: lambda t, s: self._sys_status(),
            m.SystemTime: lambda t, s: self.system_time(t),
            m.GpsRawInt: lambda t, s: self.gps(t),
            m.ScaledPressure: lambda t, s: self.scaled_pressure(t),
            m.LocalPositionNed: lambda t, s: self.local_position(t),
            m.GlobalPositionInt: lambda t, s: self.global_position(t),
            m.ServoOutputRaw: lambda t, s: self._servos(t),
            m.RcChannels: lambda t, s: self._rc_channels(t),
            m.VfrHud: lambda t, s: self.vfr_hud(),
            m.Simstate: lambda t, s: self.simstate(s),
            m.EkfStatusReport: lambda t, s: self.ekf_status(),
            m.ExtendedSysState: lambda t, s: self._extended_state(),
            m.FenceStatus: lambda t, s: None,
            m.AutopilotVersion: lambda t, s: m.AutopilotVersion(_CAPABILITIES, _VERSION, uid=1),
        }

    def build(self, kind: type[m.Message], time_us: int, share: float) -> m.Message | None:
        """Build one message; None where this vehicle has nothing to say."""
        return self._builders[kind](time_us, share)

    def battery_volts(self) -> float:
        """Return the battery's voltage under the present load."""
        full = _LOW_VOLTS if self._fc.battery_low else _FULL_VOLTS
        return full - _VOLTS_PER_AMP * self.vehicle.surroundings().current_a

    def _mag(self, place_in_order: int) -> Vector:
        """Return the corrected field of the compass of a priority (0 first), not the raw one."""
        return self._fc.compasses.field(self._fc.compasses.order[place_in_order])

    def _raw_imu(self, time_us: int, share: float) -> m.Message:
        x, y, z = self._mag(0)
        return m.RawImu(
            self.boot_us(time_us),
            *self.imu(0, share),
            int16(x),
            int16(y),
            int16(z),
            0,
            self.temperature_cdegc(),
        )

    def _scaled_imu(self, time_us: int, share: float) -> m.Message:
        x, y, z = self._mag(0)
        ms = self.boot_us(time_us) // 1000
        imu = self.imu(0, share)
        return m.ScaledImu(ms, *imu, int16(x), int16(y), int16(z), self.temperature_cdegc())

    def _scaled_imu2(self, time_us: int, share: float) -> m.Message:
        x, y, z = self._mag(1)
        ms = self.boot_us(time_us) // 1000
        imu = self.imu(1, share)
        return m.ScaledImu2(ms, *imu, int16(x), int16(y), int16(z), self.temperature_cdegc())

    def _scaled_imu3(self, time_us: int, share: float) -> m.Message:
        # There is a third compass but no third IMU.
        x, y, z = self._mag(2)
        return m.ScaledImu3(self.boot_us(time_us) // 1000, 0, 0, 0, 0, 0, 0, int16(x), int16(y), int16(z), 0)

    def _highres_imu(self, time_us: int, share: float) -> m.Message:
        ax, ay, az, gx, gy, gz = self.imu(0, share)
        x, y, z = (v * _HIGHRES_MAG_FACTOR for v in self._mag(0))
        a, g = MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS
        pressure = self.scaled_pressure(time_us).press_abs
        acc, gyro = (ax * a, ay * a, az * a), (gx * g, gy * g, gz * g)
        temperature = self.vehicle.surroundings().temperature_degc
        height = self.vehicle.body.height_m
        return m.HighresImu(
            self.boot_us(time_us), *acc, *gyro, x, y, z, pressure, 0.0, height, temperature, 0x1BFF, 0
        )

    def _sys_status(self) -> m.Message:
        fc = self._fc
        health = _SENSOR_BITS
        if not fc.compasses.healthy(fc.compasses.order[0]):
            health &= ~_SENSOR_MAG
        if not fc.armed and arming_refusals(fc):
            health &= ~_SENSOR_PREARM
        current = self.vehicle.surroundings().current_a
        left = int(100.0 * (1.0 - self.vehicle.consumed_mah / _CAPACITY_MAH))
        return m.SysStatus(
            onboard_control_sensors_present=_SENSOR_BITS,
            onboard_control_sensors_enabled=_SENSOR_BITS,
            onboard_control_sensors_health=health,
            voltage_battery=int(1000.0 * self.battery_volts()),
            current_battery=int(100.0 * current),
            battery_remaining=max(0, min(left, 9 if fc.battery_low else 100)),
        )

    def _servos(self, time_us: int) -> m.Message:
        throttle = self.vehicle.surroundings().throttle
        turn = self.vehicle.body.yaw_rate_radps / self.vehicle.profile.yaw_rate_max_radps
        if self.vehicle.profile.hovers:
            pwm = [int(1000 + 1000 * throttle)] * 4
        else:
            ahead = self.vehicle.body.speed_mps / self.vehicle.profile.speed_max_mps
            pwm = [int(1500 + 400 * (ahead + turn)), 0, int(1500 + 400 * (ahead - turn)), 0]
        return m.ServoOutputRaw(self.boot_us(time_us), 0, *pwm)

    def _rc_channels(self, time_us: int) -> m.Message:
        channels = self._fc.radio.channels(self.vehicle.boot_time_s)
        unused = (0,) * (18 - len(channels))
        return m.RcChannels(self.boot_us(time_us) // 1000, len(channels), *channels, *unused)

    def _extended_state(self) -> m.Message:
        landed = self.vehicle.body.landed
        return m.ExtendedSysState(0, _LANDED_ON_GROUND if landed else _LANDED_IN_AIR)
