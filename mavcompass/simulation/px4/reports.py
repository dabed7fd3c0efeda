"""PX4's telemetry: the raw field in the sensor's axes in SCALED_IMU, the corrected one in HIGHRES_IMU."""

from __future__ import annotations

from collections.abc import Mapping

from mavcompass import messages as m
from mavcompass.enums import EkfFlag, MavAutopilot, MavModeFlag
from mavcompass.simulation.autopilot.board import Board, Status
from mavcompass.simulation.autopilot.guidance import Radio
from mavcompass.simulation.autopilot.parameters import ParameterStore
from mavcompass.simulation.autopilot.reports import Battery, Reports, between
from mavcompass.simulation.autopilot.telemetry import MESSAGE_IDS
from mavcompass.simulation.px4.compasses import Px4Compasses
from mavcompass.simulation.px4.flight import Arming, base_mode, custom_mode
from mavcompass.units import MGAUSS_PER_GAUSS

# What a ground station's link carries unasked, hertz.
_DEFAULT_RATES: dict[type[m.Message], float] = {
    m.SysStatus: 1.0,
    m.SystemTime: 1.0,
    m.Attitude: 15.0,
    m.GlobalPositionInt: 5.0,
    m.LocalPositionNed: 1.0,
    m.GpsRawInt: 1.0,
    m.VfrHud: 4.0,
    m.ExtendedSysState: 1.0,
    m.EstimatorStatus: 1.0,
    m.HighresImu: 1.5,
    m.RcChannels: 5.0,
}
_VERSION = 1 << 24 | 15 << 16 | 4 << 8 | 255
# PARAM_FLOAT, MISSION_INT, COMMAND_INT, PARAM_ENCODE_BYTEWISE, FTP, SET_ATTITUDE_TARGET,
# SET_POSITION_TARGET_LOCAL_NED, MAVLINK2.
_CAPABILITIES = 1 << 1 | 1 << 2 | 1 << 3 | 1 << 4 | 1 << 5 | 1 << 6 | 1 << 7 | 1 << 13
# Gyro, accelerometer, magnetometer, barometer, GPS, rate, attitude, yaw, altitude and position control.
_SENSOR_BITS = 0x1 | 0x2 | 0x4 | 0x8 | 0x20 | 0x400 | 0x800 | 0x1000 | 0x2000 | 0x4000
_SENSOR_MAG, _SENSOR_PREARM = 1 << 2, 1 << 28
# fields_updated: acceleration, rate, magnetic field, pressure, altitude, temperature.
_ALL_FIELDS = 0x1BFF


class Px4Reports(Reports):
    """Build PX4's messages."""

    autopilot = MavAutopilot.PX4
    battery = Battery(full_volts=16.4, low_volts=14.0, volts_per_amp=0.012, low_percent=6)
    unused_channel = 65535
    capabilities, version = _CAPABILITIES, _VERSION
    compasses: Px4Compasses

    def __init__(
        self,
        board: Board,
        status: Status,
        compasses: Px4Compasses,
        radio: Radio,
        arming: Arming,
        store: ParameterStore,
    ) -> None:
        super().__init__(board, status, compasses, radio)
        self._arming = arming
        self._store = store
        self.builders |= {
            m.ScaledImu: lambda t, s: m.ScaledImu(*self._scaled(t, s, 0)),
            m.ScaledImu2: lambda t, s: m.ScaledImu2(*self._scaled(t, s, 1)),
            m.HighresImu: self._highres_imu,
            m.EstimatorStatus: self._estimator_status,
            m.GlobalPositionInt: lambda t, s: self.global_position(t) if self.board.ready else None,
        }

    def default_intervals(self) -> Mapping[int, int]:
        """Return what a ground station's link carries unasked."""
        return {MESSAGE_IDS[kind]: int(1e6 / rate) for kind, rate in _DEFAULT_RATES.items()}

    @property
    def capacity_mah(self) -> float:
        """Return the battery's capacity."""
        return self._store["BAT1_CAPACITY"]

    def mode_numbers(self) -> tuple[MavModeFlag, int]:
        """Return HEARTBEAT's base_mode and custom_mode."""
        return base_mode(self.status.mode, self.status.armed), custom_mode(self.status.mode)

    def active(self) -> bool:
        """Tell whether the vehicle is ACTIVE."""
        return self.status.armed

    def sensors_present_and_healthy(self) -> tuple[int, int]:
        """Return SYS_STATUS's bits."""
        present = healthy = _SENSOR_BITS | _SENSOR_PREARM
        if not self.compasses.healthy(self.compasses.steering or 1):
            healthy &= ~_SENSOR_MAG
        if self._arming.refusal():
            healthy &= ~_SENSOR_PREARM
        return present, healthy

    def _scaled(self, time_us: int, share: float, index: int) -> tuple[int, ...]:
        # Whole degrees, although the message counts hundredths.
        degrees = int(self.board.surroundings().temperature_degc)
        return self.scaled_imu(time_us, share, index, self.compasses.raw_sensor_mgauss[index], degrees)

    def _estimator_status(self, time_us: int, share: float) -> m.EstimatorStatus:
        """Report the filter's health: attitude and height, and the position once it is known."""
        flags = EkfFlag.ATTITUDE | EkfFlag.VELOCITY_HORIZ | EkfFlag.VELOCITY_VERT | EkfFlag.POS_VERT_ABS
        flags |= EkfFlag.POS_HORIZ_REL | EkfFlag.POS_HORIZ_ABS if self.board.ready else EkfFlag.CONST_POS_MODE
        ratio = self.board.filter.compass_variance
        return m.EstimatorStatus(self.boot_us(time_us), int(flags), mag_ratio=ratio)

    def _highres_imu(self, time_us: int, share: float) -> m.Message:
        sensors, place = self.board.sensors, (self.compasses.steering or 1) - 1
        before, now = sensors.previous[0], sensors.samples[0]
        acc = between(before.acc_mps2, now.acc_mps2, share)
        gyro = between(before.gyro_radps, now.gyro_radps, share)
        x, y, z = (v / MGAUSS_PER_GAUSS for v in self.compasses.fields[place])
        pressure = self.scaled_pressure(time_us).press_abs
        height = self.board.world.place.alt_m + self.board.body.height_m
        degrees = self.board.surroundings().temperature_degc
        us = self.boot_us(time_us)
        return m.HighresImu(us, *acc, *gyro, x, y, z, pressure, 0.0, height, degrees, _ALL_FIELDS, 0)
