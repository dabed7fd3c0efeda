"""PX4's telemetry: the raw field in the sensor's axes in SCALED_IMU, the corrected one in HIGHRES_IMU."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from mavcompass import messages as m
from mavcompass.simulation.autopilot.reports import Reports, between, int16
from mavcompass.units import MGAUSS_PER_GAUSS

if TYPE_CHECKING:
    from mavcompass.simulation.px4.firmware import Px4

Builder = Callable[[int, float], m.Message | None]

_VERSION = 1 << 24 | 15 << 16 | 4 << 8 | 255
# PARAM_FLOAT, MISSION_INT, COMMAND_INT, PARAM_ENCODE_BYTEWISE, FTP, SET_ATTITUDE_TARGET,
# SET_POSITION_TARGET_LOCAL_NED, MAVLINK2.
_CAPABILITIES = 1 << 1 | 1 << 2 | 1 << 3 | 1 << 4 | 1 << 5 | 1 << 6 | 1 << 7 | 1 << 13
# Gyro, accelerometer, magnetometer, barometer, GPS, rate, attitude, yaw, altitude and position control.
_SENSOR_BITS = 0x1 | 0x2 | 0x4 | 0x8 | 0x20 | 0x400 | 0x800 | 0x1000 | 0x2000 | 0x4000
_SENSOR_MAG, _SENSOR_PREARM = 1 << 2, 1 << 28
_LANDED_ON_GROUND, _LANDED_IN_AIR = 1, 2
_FULL_VOLTS, _VOLTS_PER_AMP, _LOW_VOLTS = 16.4, 0.012, 14.0
# fields_updated: acceleration, rate, magnetic field, pressure, altitude, temperature.
_ALL_FIELDS = 0x1BFF


class Px4Reports(Reports):
    """Build PX4's messages."""

    def __init__(self, firmware: Px4) -> None:
        super().__init__(firmware.vehicle)
        self._fc = firmware
        self._builders: dict[type[m.Message], Builder] = {
            m.ScaledImu: lambda t, s: m.ScaledImu(*self._scaled(t, s, 0)),
            m.ScaledImu2: lambda t, s: m.ScaledImu2(*self._scaled(t, s, 1)),
            m.HighresImu: self._highres_imu,
            m.Attitude: self.attitude,
            m.Heartbeat: lambda t, s: self._fc.heartbeat(),
            m.SysStatus: lambda t, s: self._sys_status(),
            m.SystemTime: lambda t, s: self.system_time(t),
            m.GpsRawInt: lambda t, s: self.gps(t),
            m.ScaledPressure: lambda t, s: self.scaled_pressure(t),
            m.LocalPositionNed: lambda t, s: self.local_position(t),
            m.GlobalPositionInt: lambda t, s: self.global_position(t) if self.vehicle.ready else None,
            m.ServoOutputRaw: lambda t, s: self._servos(t),
            m.RcChannels: lambda t, s: self._rc_channels(t),
            m.VfrHud: lambda t, s: self.vfr_hud(),
            m.ExtendedSysState: lambda t, s: self._extended_state(),
            m.AutopilotVersion: lambda t, s: m.AutopilotVersion(_CAPABILITIES, _VERSION, uid=1),
        }

    @property
    def kinds(self) -> frozenset[type[m.Message]]:
        """Return the messages that this firmware can build."""
        return frozenset(self._builders)

    def build(self, kind: type[m.Message], time_us: int, share: float) -> m.Message | None:
        """Build one message; None where this vehicle has nothing to say."""
        return self._builders[kind](time_us, share)

    def battery_volts(self) -> float:
        """Return the battery's voltage under the present load."""
        full = _LOW_VOLTS if self._fc.battery_low else _FULL_VOLTS
        return full - _VOLTS_PER_AMP * self.vehicle.surroundings().current_a

    def _scaled(self, time_us: int, share: float, index: int) -> tuple[int, ...]:
        x, y, z = self._fc.compasses.raw_sensor_mgauss[index]
        imu = self.imu(index, share)
        # Whole degrees, although the message counts hundredths.
        degrees = int(self.vehicle.surroundings().temperature_degc)
        return (self.boot_us(time_us) // 1000, *imu, int16(x), int16(y), int16(z), degrees)

    def _highres_imu(self, time_us: int, share: float) -> m.Message:
        sensors, place = self.vehicle.sensors, (self._fc.compasses.steering or 1) - 1
        before, now = sensors.previous[0], sensors.samples[0]
        acc = between(before.acc_mps2, now.acc_mps2, share)
        gyro = between(before.gyro_radps, now.gyro_radps, share)
        x, y, z = (v / MGAUSS_PER_GAUSS for v in self._fc.compasses.fields[place])
        pressure = self.scaled_pressure(time_us).press_abs
        height = self.vehicle.world.place.alt_m + self.vehicle.body.height_m
        degrees = self.vehicle.surroundings().temperature_degc
        us = self.boot_us(time_us)
        return m.HighresImu(us, *acc, *gyro, x, y, z, pressure, 0.0, height, degrees, _ALL_FIELDS, 0)

    def _sys_status(self) -> m.Message:
        health = _SENSOR_BITS | _SENSOR_PREARM
        if not self._fc.compasses.healthy(self._fc.compasses.steering or 1):
            health &= ~_SENSOR_MAG
        if self._fc.refusal():
            health &= ~_SENSOR_PREARM
        current = self.vehicle.surroundings().current_a
        left = int(100.0 * (1.0 - self.vehicle.consumed_mah / self._fc.store["BAT1_CAPACITY"]))
        return m.SysStatus(
            onboard_control_sensors_present=_SENSOR_BITS | _SENSOR_PREARM,
            onboard_control_sensors_enabled=_SENSOR_BITS | _SENSOR_PREARM,
            onboard_control_sensors_health=health,
            voltage_battery=int(1000.0 * self.battery_volts()),
            current_battery=int(100.0 * current),
            battery_remaining=max(0, min(left, 6 if self._fc.battery_low else 100)),
        )

    def _servos(self, time_us: int) -> m.Message:
        pwm = int(1000 + 1000 * self.vehicle.surroundings().throttle)
        return m.ServoOutputRaw(self.boot_us(time_us) & 0xFFFFFFFF, 0, pwm, pwm, pwm, pwm)

    def _rc_channels(self, time_us: int) -> m.Message:
        channels = self._fc.radio.channels(self.vehicle.boot_time_s)
        return m.RcChannels(self.boot_us(time_us) // 1000, len(channels), *channels)

    def _extended_state(self) -> m.Message:
        landed = self.vehicle.body.landed
        return m.ExtendedSysState(0, _LANDED_ON_GROUND if landed else _LANDED_IN_AIR)
