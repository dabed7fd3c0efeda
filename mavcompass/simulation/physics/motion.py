"""How a simulated vehicle moves: turning, tilting, drifting, driving, climbing.

The step is fixed and short (10 or 20 ms). Yaw is integrated by the trapezoid, so the integral of the
true rate over any time is the angle really turned. All is plain float arithmetic: a numpy call on
three numbers costs more than the whole step.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from mavcompass.correction import Vector
from mavcompass.frames import wrap_angle
from mavcompass.simulation.physics.hand import Hand, HandMotion
from mavcompass.simulation.physics.noise import NoiseTape, generator
from mavcompass.simulation.physics.profiles import VehicleProfile
from mavcompass.simulation.physics.world import World
from mavcompass.units import STANDARD_GRAVITY_MPS2

Rotation = tuple[float, float, float, float, float, float, float, float, float]

_CLIMB_LAG_S = 0.4
_FALL_MPS, _BUOYANT_MPS = 8.0, 0.1
# A sheltered harbour's stream at most.
_STREAM_MPS = 0.06
_SPEED_ACCELERATION_MPS2 = 1.5
_TREMOR_RAD, _TREMOR_PERIOD_S = math.radians(0.5), 0.8
# Angles and rates below this, in radians and per second, count as rest.
_AT_REST = 1e-7
_STICTION_RADPS = math.radians(0.25)
# A suspension, a hull, an airframe takes so long to lean.
_LEAN_LAG_S = 0.2
# A position controller leans a copter back by so much acceleration per metre and per metre per second.
_HOLD_PER_S2, _HOLD_PER_S = 0.3, 1.0


@dataclass(slots=True)
class Drive:
    """Say what the controllers ask of the chassis.

    `yaw_rate_radps` None lets go of the yaw (brakes on the ground, coasts in air and water).
    """

    yaw_rate_radps: float | None = None
    speed_mps: float = 0.0
    climb_mps: float = 0.0
    motors_on: bool = False


def rotation_matrix(roll: float, pitch: float, yaw: float) -> Rotation:
    """Return the body-to-NED rotation, row by row."""
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return (
        cp * cy,
        sr * sp * cy - cr * sy,
        cr * sp * cy + sr * sy,
        cp * sy,
        sr * sp * sy + cr * cy,
        cr * sp * sy - sr * cy,
        -sp,
        sr * cp,
        cr * cp,
    )


def times(rows: Sequence[float], vector: Vector) -> Vector:
    """Return a matrix, row by row, times a vector."""
    m, (x, y, z) = rows, vector
    return (
        m[0] * x + m[1] * y + m[2] * z,
        m[3] * x + m[4] * y + m[5] * z,
        m[6] * x + m[7] * y + m[8] * z,
    )


class Body:
    """Be the true vehicle: where it is, how it stands and moves.

    `height_m` is above the start's ground (negative under water); `landed` tells that the ground
    carries it.
    """

    def __init__(self, profile: VehicleProfile, world: World, seed: int, yaw_rad: float) -> None:
        self.profile = profile
        self.world = world
        self.yaw_rad = yaw_rad
        self.yaw_rate_radps = 0.0
        self.roll_rad = self.pitch_rad = 0.0
        self.roll_rate_radps = self.pitch_rate_radps = 0.0
        self.north_m = self.east_m = self.height_m = 0.0
        self.speed_mps = self.climb_mps = 0.0
        self.velocity_ned_mps: Vector = (0.0, 0.0, 0.0)
        self.forward_acceleration_mps2 = 0.0
        # How far it leans right and nose up by its own acceleration, and how fast.
        self._leaning = [0.0, 0.0, 0.0, 0.0]
        self.time_s = 0.0
        self.motors_on = False
        self.hand = Hand()
        self.jammed = False
        self._held = HandMotion()
        self._tape = NoiseTape(generator(seed, "motion"), 4)
        self._jitter = [0.0, 0.0, 0.0, 0.0]
        self._unrest_radps = 0.0
        # How far, how fast and with what acceleration a hover sways; north and east.
        self._sway = [(0.0, 0.0), (0.0, 0.0), (0.0, 0.0)]
        rng = generator(seed, "wind")
        heading, strength = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.3, 1.0)
        lean = 2.0 * profile.jitter_rad * strength
        self._lean_ned = (lean * math.cos(heading), lean * math.sin(heading))
        self._stream_mps = (
            (_STREAM_MPS * strength * math.cos(heading), _STREAM_MPS * strength * math.sin(heading))
            if profile.chassis == "boat"
            else (0.0, 0.0)
        )
        self._settle()

    @property
    def shaking(self) -> float:
        """Return how much of the motors' vibration is felt, 0..1: wheels that stand do not shake."""
        if not self.motors_on:
            return 0.0
        if self.profile.hovers:
            return 1.0
        return min(1.0, abs(self.yaw_rate_radps) / 0.5 + abs(self.speed_mps))

    @property
    def landed(self) -> bool:
        """Tell whether the ground carries the vehicle."""
        return not self.profile.hovers or (self.profile.hover_m > 0.0 and self.height_m <= 0.0)

    def place_at_height(self, height_m: float) -> None:
        """Put the vehicle at a height, at rest, motors running: the start of a hover."""
        self.height_m = height_m
        self.motors_on = True
        self._settle()

    def step(self, dt_s: float, drive: Drive, measured_yaw_rate_radps: float) -> None:
        """Move on by one step; the rate controller sees the gyro's rate, not the true one."""
        self.time_s += dt_s
        self.motors_on = drive.motors_on
        noise = self._tape.row()
        self._held = self.hand.at(self.time_s)
        self._turn(dt_s, drive, measured_yaw_rate_radps, noise[0])
        self._sway_on(dt_s)
        self._translate(dt_s, drive)
        self._tilt(dt_s, noise)
        self._lean_on(dt_s)
        self._settle()

    @property
    def acceleration_mps2(self) -> tuple[float, float]:
        """Return the acceleration ahead and to the right, level, by what it drives: speed and bend."""
        return self.forward_acceleration_mps2, self.speed_mps * self.yaw_rate_radps

    def _lean_on(self, dt: float) -> None:
        """Lean by its own acceleration: a copter to make it, wheels out of the bend, a hull into it."""
        ahead, right = self.acceleration_mps2
        each = 1.0 / STANDARD_GRAVITY_MPS2 if self.profile.leans_to_move else self.profile.lean_rad_per_mps2
        j = self._leaning
        for i, target in enumerate((each * right, -each * ahead)):
            j[2 + i] = (target - j[i]) / _LEAN_LAG_S
            j[i] += j[2 + i] * dt

    def _turn(self, dt: float, drive: Drive, measured: float, noise: float) -> None:
        p = self.profile
        limit = p.yaw_acceleration_radps2
        if self._held.moving:
            acceleration = (self._held.yaw_rate_radps - self.yaw_rate_radps) / dt
        elif drive.yaw_rate_radps is None or self.jammed:
            acceleration = max(-p.coast_radps2, min(p.coast_radps2, -self.yaw_rate_radps / dt))
        else:
            wanted = max(-p.yaw_rate_max_radps, min(p.yaw_rate_max_radps, drive.yaw_rate_radps))
            if p.turn_radius_m:
                most = abs(self.speed_mps) / p.turn_radius_m
                wanted = max(-most, min(most, wanted))
            acceleration = max(-2.0 * limit, min(2.0 * limit, (wanted - measured) / p.yaw_lag_s))
            slow = abs(wanted) < _STICTION_RADPS and abs(self.yaw_rate_radps) < _STICTION_RADPS
            if slow and self.landed_on_ground:
                # The tyres hold: the motors' little push does not move what stands.
                acceleration = -self.yaw_rate_radps / dt
        if p.yaw_unrest_radps and not self.landed_on_ground:
            # Gusts and small waves: a first-order process with a time constant of two seconds.
            self._unrest_radps += -0.5 * dt * self._unrest_radps
            self._unrest_radps += p.yaw_unrest_radps * math.sqrt(dt) * noise
            acceleration += self._unrest_radps
        before = self.yaw_rate_radps
        self.yaw_rate_radps = before + acceleration * dt
        yaw = self.yaw_rad + 0.5 * (before + self.yaw_rate_radps) * dt
        self.yaw_rad = wrap_angle(yaw)

    @property
    def landed_on_ground(self) -> bool:
        """Tell whether it stands on solid ground."""
        return self.landed and self.profile.chassis != "boat"

    def _translate(self, dt: float, drive: Drive) -> None:
        most = _SPEED_ACCELERATION_MPS2 * dt
        fastest = self.profile.speed_max_mps
        wanted = max(-fastest, min(fastest, drive.speed_mps))
        change = max(-most, min(most, wanted - self.speed_mps))
        self.speed_mps += change
        self.forward_acceleration_mps2 = change / dt
        stream, sway = self._stream_mps, self._sway[1]
        north = self.speed_mps * math.cos(self.yaw_rad) + stream[0] + sway[0]
        east = self.speed_mps * math.sin(self.yaw_rad) + stream[1] + sway[1]
        self.north_m += north * dt
        self.east_m += east * dt
        if self.profile.hovers:
            climb = drive.climb_mps if drive.motors_on else self._climb_unpowered()
            self.climb_mps += (climb - self.climb_mps) * dt / _CLIMB_LAG_S
            self.height_m += self.climb_mps * dt
            bottom, top = (0.0, math.inf) if self.profile.hover_m > 0.0 else (-100.0, 0.0)
            if not bottom < self.height_m < top:
                self.height_m = max(bottom, min(top, self.height_m))
                self.climb_mps = 0.0
        self.velocity_ned_mps = (north, east, -self.climb_mps)

    def _sway_on(self, dt: float) -> None:
        """Let a copter be pushed by its own lean, and its position controller lean it back."""
        if not self.profile.leans_to_move or self.landed:
            self._sway = [(0.0, 0.0), (0.0, 0.0), (0.0, 0.0)]
            return
        (north, east), (v_north, v_east), _ = self._sway
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        g = STANDARD_GRAVITY_MPS2
        right, ahead = g * self._jitter[0], -g * self._jitter[1]
        a_north = ahead * c - right * s - _HOLD_PER_S2 * north - _HOLD_PER_S * v_north
        a_east = ahead * s + right * c - _HOLD_PER_S2 * east - _HOLD_PER_S * v_east
        v_north, v_east = v_north + a_north * dt, v_east + a_east * dt
        self._sway = [(north + v_north * dt, east + v_east * dt), (v_north, v_east), (a_north, a_east)]

    def _climb_unpowered(self) -> float:
        """Return the climb rate without motors: a copter falls, a sub rises slowly."""
        return -_FALL_MPS if self.profile.hover_m > 0.0 else _BUOYANT_MPS

    def _tilt(self, dt: float, noise: list[float]) -> None:
        """Let roll and pitch swing, in the air or in trembling hands: damped oscillators driven by noise."""
        p, j = self.profile, self._jitter
        amplitude, period = p.jitter_rad, p.jitter_period_s
        if self._held.moving:
            amplitude, period = _TREMOR_RAD, _TREMOR_PERIOD_S
        elif self.landed or not amplitude:
            # What trembled comes to rest where it stands: no tilt ends without a rate.
            amplitude, period = 0.0, _TREMOR_PERIOD_S
            if max(map(abs, j)) < _AT_REST:
                j[0] = j[1] = j[2] = j[3] = 0.0
                return
        omega = 2.0 * math.pi / period
        zeta = 0.5
        # The stationary variance of x of x'' + 2 z w x' + w^2 x = q n is q^2 / (4 z w^3).
        drive = amplitude * math.sqrt(4.0 * zeta * omega**3) * math.sqrt(dt)
        for i in (0, 1):
            before = j[2 + i]
            pull = -2.0 * zeta * omega * before - omega * omega * j[i]
            j[2 + i] = before + dt * pull + drive * noise[1 + i]
            j[i] += 0.5 * dt * (before + j[2 + i])

    def _settle(self) -> None:
        """Bring attitude, rotation, body rate and specific force in line with the state."""
        if self.landed_on_ground:
            tilt = self._ground_tilt()
        elif self.profile.chassis == "boat":
            tilt = self.world.water_tilt(self.time_s)
        else:
            tilt = self._hover_tilt()
        leaning = self._leaning
        self.roll_rad, self.pitch_rad = tilt[0] + leaning[0], tilt[1] + leaning[1]
        self.roll_rate_radps, self.pitch_rate_radps = tilt[2] + leaning[2], tilt[3] + leaning[3]
        self.rotation = rotation_matrix(self.roll_rad, self.pitch_rad, self.yaw_rad)
        self.rate_radps = self._body_rate()
        self.specific_force_mps2 = self._specific_force()

    def _ground_tilt(self) -> tuple[float, float, float, float]:
        roll, pitch, roll_rate, pitch_rate = self.world.ground_tilt(self.yaw_rad, self.yaw_rate_radps)
        h, j = self._held, self._jitter
        return (
            roll + h.roll_rad + j[0],
            pitch + h.pitch_rad + j[1],
            roll_rate + h.roll_rate_radps + j[2],
            pitch_rate + h.pitch_rate_radps + j[3],
        )

    def _hover_tilt(self) -> tuple[float, float, float, float]:
        """Lean into the wind, back to the place, and as the gusts will."""
        c, s, w = math.cos(self.yaw_rad), math.sin(self.yaw_rad), self.yaw_rate_radps
        g, (wind_north, wind_east) = STANDARD_GRAVITY_MPS2, self._lean_ned
        (x_north, x_east), (v_north, v_east), (a_north, a_east) = self._sway
        north = wind_north - (_HOLD_PER_S2 * x_north + _HOLD_PER_S * v_north) / g
        east = wind_east - (_HOLD_PER_S2 * x_east + _HOLD_PER_S * v_east) / g
        north_rate = -(_HOLD_PER_S2 * v_north + _HOLD_PER_S * a_north) / g
        east_rate = -(_HOLD_PER_S2 * v_east + _HOLD_PER_S * a_east) / g
        ahead, right = north * c + east * s, -north * s + east * c
        ahead_rate, right_rate = (
            north_rate * c + east_rate * s + right * w,
            -north_rate * s + east_rate * c - ahead * w,
        )
        j = self._jitter
        return right + j[0], -ahead + j[1], right_rate + j[2], -ahead_rate + j[3]

    def _body_rate(self) -> Vector:
        sr, cr = math.sin(self.roll_rad), math.cos(self.roll_rad)
        sp, cp = math.sin(self.pitch_rad), math.cos(self.pitch_rad)
        return (
            self.roll_rate_radps - self.yaw_rate_radps * sp,
            self.pitch_rate_radps * cr + self.yaw_rate_radps * cp * sr,
            -self.pitch_rate_radps * sr + self.yaw_rate_radps * cp * cr,
        )

    def _specific_force(self) -> Vector:
        m, g = self.rotation, STANDARD_GRAVITY_MPS2
        ahead, right = self.acceleration_mps2
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        north, east = self._sway[2]
        north, east = north + ahead * c - right * s, east + ahead * s + right * c
        return (
            m[0] * north + m[3] * east - g * m[6],
            m[1] * north + m[4] * east - g * m[7],
            m[2] * north + m[5] * east - g * m[8],
        )
