"""ArduPilot's telemetry: what its fields really carry, which is not always what their names say."""

from __future__ import annotations

from collections.abc import Mapping

from mavcompass import messages as m
from mavcompass.correction import Vector
from mavcompass.enums import EkfFlag, MavAutopilot, MavModeFlag
from mavcompass.simulation.ardupilot.arming import Arming
from mavcompass.simulation.ardupilot.compasses import CompassBank
from mavcompass.simulation.ardupilot.modes import ModeRules
from mavcompass.simulation.autopilot.board import Board, Status
from mavcompass.simulation.autopilot.guidance import Radio
from mavcompass.simulation.autopilot.parameters import ParameterStore
from mavcompass.simulation.autopilot.reports import Battery, Reports, int16
from mavcompass.simulation.autopilot.telemetry import MESSAGES
from mavcompass.units import MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS

_SENSOR_BITS = 322034735
_SENSOR_MAG, _SENSOR_PREARM = 1 << 2, 1 << 28
# 4.6.3, an official release.
_VERSION = 4 << 24 | 6 << 16 | 3 << 8 | 255
# MISSION_INT, COMMAND_INT, PARAM_ENCODE_C_CAST, SET_ATTITUDE_TARGET, SET_POSITION_TARGET_LOCAL_NED,
# MAVLINK2, COMPASS_CALIBRATION.
_CAPABILITIES = 1 << 2 | 1 << 3 | 1 << 17 | 1 << 6 | 1 << 7 | 1 << 13 | 1 << 12
# The simulated firmware's HIGHRES_IMU carries a thousand times milligauss where gauss are due.
_HIGHRES_MAG_FACTOR = 1000.0


class ArduPilotReports(Reports):
    """Build ArduPilot's messages."""

    autopilot = MavAutopilot.ARDUPILOTMEGA
    battery = Battery(full_volts=12.6, low_volts=10.4, volts_per_amp=0.01, low_percent=9)
    unused_channel = 0
    capabilities, version = _CAPABILITIES, _VERSION
    capacity_mah = 3300.0
    compasses: CompassBank

    def __init__(
        self,
        board: Board,
        status: Status,
        compasses: CompassBank,
        radio: Radio,
        rules: ModeRules,
        arming: Arming,
        store: ParameterStore,
    ) -> None:
        super().__init__(board, status, compasses, radio)
        self._rules = rules
        self._arming = arming
        self._store = store
        self.builders |= {
            m.RawImu: self._raw_imu,
            m.ScaledImu: lambda t, s: m.ScaledImu(*self._scaled(t, s, 0)),
            m.ScaledImu2: lambda t, s: m.ScaledImu2(*self._scaled(t, s, 1)),
            m.ScaledImu3: lambda t, s: self._third_compass(t),
            m.HighresImu: self._highres_imu,
            m.Simstate: lambda t, s: self._simstate(s),
            m.EkfStatusReport: lambda t, s: self._ekf_status(),
            m.FenceStatus: lambda t, s: None,
        }

    def default_intervals(self) -> Mapping[int, int]:
        """Return what the SR0 parameters stream."""
        return {
            number: int(1e6 / rate)
            for number, (_, group) in MESSAGES.items()
            if group and (rate := self._store.get(f"SR0_{group}")) > 0.0
        }

    def mode_numbers(self) -> tuple[MavModeFlag, int]:
        """Return HEARTBEAT's base_mode and custom_mode."""
        mode = self.status.mode
        base_mode = self._rules.base_mode(mode, self.status.armed, self.board.profile.firmware)
        return base_mode, self._rules.names[mode]

    def active(self) -> bool:
        """Tell whether the vehicle is ACTIVE: what hovers does so armed and off the ground only."""
        return not self.board.profile.hovers or (self.status.armed and not self.board.body.landed)

    def sensors_present_and_healthy(self) -> tuple[int, int]:
        """Return SYS_STATUS's bits."""
        health = _SENSOR_BITS
        if not self.compasses.healthy(self.compasses.order[0]):
            health &= ~_SENSOR_MAG
        if not self.status.armed and self._arming.refusals():
            health &= ~_SENSOR_PREARM
        return _SENSOR_BITS, health

    def _mag(self, place_in_order: int) -> Vector:
        """Return the corrected field of the compass of a priority (0 first), not the raw one."""
        return self.compasses.field(self.compasses.order[place_in_order])

    def _raw_imu(self, time_us: int, share: float) -> m.Message:
        x, y, z = (int16(v) for v in self._mag(0))
        temperature = self.temperature_cdegc()
        return m.RawImu(self.boot_us(time_us), *self.imu(0, share), x, y, z, temperature=temperature)

    def _scaled(self, time_us: int, share: float, index: int) -> tuple[int, ...]:
        return self.scaled_imu(time_us, share, index, self._mag(index), self.temperature_cdegc())

    def _third_compass(self, time_us: int) -> m.ScaledImu3:
        # There is a third compass but no third IMU.
        x, y, z = self._mag(2)
        return m.ScaledImu3(self.boot_us(time_us) // 1000, 0, 0, 0, 0, 0, 0, int16(x), int16(y), int16(z), 0)

    def _highres_imu(self, time_us: int, share: float) -> m.Message:
        ax, ay, az, gx, gy, gz = self.imu(0, share)
        x, y, z = (v * _HIGHRES_MAG_FACTOR for v in self._mag(0))
        a, g = MPS2_PER_MILLI_G, RADPS_PER_MILLIRADPS
        pressure = self.scaled_pressure(time_us).press_abs
        acc, gyro = (ax * a, ay * a, az * a), (gx * g, gy * g, gz * g)
        temperature = self.board.surroundings().temperature_degc
        height = self.board.body.height_m
        return m.HighresImu(
            self.boot_us(time_us), *acc, *gyro, x, y, z, pressure, 0.0, height, temperature, 0x1BFF, 0
        )

    def _simstate(self, share: float) -> m.Simstate:
        """Report the truth, as simulations do."""
        b = self.board.body
        yaw = b.yaw_rad - b.yaw_rate_radps * self.back_s(share)
        lat, lon, _ = self.place()
        (x, y, z), (p, q, r) = b.specific_force_mps2, b.rate_radps
        return m.Simstate(b.roll_rad, b.pitch_rad, yaw, x, y, z, p, q, r, lat, lon)

    def _ekf_status(self) -> m.EkfStatusReport:
        """Report the filter's health."""
        ready = self.board.ready
        flags = EkfFlag.ATTITUDE | EkfFlag.VELOCITY_HORIZ | EkfFlag.VELOCITY_VERT | EkfFlag.POS_VERT_ABS
        # Bits 8 and 9: predicted positions are good; GPS quality allows.
        position = EkfFlag.POS_HORIZ_REL | EkfFlag.POS_HORIZ_ABS | 0x300
        flags |= position if ready else EkfFlag.CONST_POS_MODE
        return m.EkfStatusReport(int(flags), 0.007, 0.008, 0.007, self.board.filter.compass_variance)
