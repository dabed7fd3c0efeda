"""Roll and pitch of what moves, reading by reading, with their sigma: one causal filter for every door.

A frame that the gyro carries along is level but for a small rotation tau, and Newton's law tells that from
acceleration (horizontal vectors are complex numbers, forward + i right at the start; f is the specific force,
b the gyro's bias in the body, E the body's x axis in the frame):

    v' = f + i g tau,    tau' = -E b,    v = c u,    tau_a = tau + e                                     (L1)

The receiver's velocity u lies in the frame under an unknown rotation c, so that no compass has a say: where c
is not known yet its speed bounds v, and acceleration tells c. Where nothing measures u, what moves is bounded
by what such things do. The autopilot's roll and pitch tau_a err by e, which lasts: it turns the acceleration
that it sees by as much as its yaw is wrong. All of (L1) is linear, alike in both axes, and a Kalman filter of
five complex numbers (v, tau, b, c, e), written out: for matrices of five the calls of numpy take longer than
the sums. Variances are those of one axis.
"""

from __future__ import annotations

import math
from collections import deque

from mavcompass.attitude.standing import LOOK_S, Standing
from mavcompass.attitude.vectors import Vector, bend2, changed2, cross, dot, middle, squared, turned_frame
from mavcompass.gravity import is_gravity
from mavcompass.kinds import HOVERING
from mavcompass.units import STANDARD_GRAVITY_MPS2

# The upper triangle of the covariance, row by row; the lower one is its conjugate.
Covariance = tuple[complex, ...]
# Of force and rate, squared: horizontal and vertical.
Changes = tuple[tuple[float, float], tuple[float, float]]

_G = STANDARD_GRAVITY_MPS2
_V, _TAU, _B, _C, _E = range(5)
# Where their variances stand in the triangle.
_TAU_TAU, _B_B, _C_C = 5, 9, 12
# What stands, floats or is held upright by its buoyancy, and a box of sensors of which nothing is known:
# where these are still, the accelerometer shows gravity. What hovers leans with its thrust, and reads level.
ON_THE_GROUND = frozenset({"rover", "ackermann-rover", "boat"})
UPHELD = ON_THE_GROUND | {"sub", "unknown"}
# Of one velocity of a satellite receiver; its error lasts for about a second. And its delay.
RECEIVER_SIGMA_MPS, _RECEIVER_MEMORY_S, RECEIVER_LAG_S = 0.1, 1.0, 0.11
# Where nothing measures the velocity: what a hovering copter, a hand and what drives do.
_BOUND_MPS: dict[str, float] = {**dict.fromkeys(HOVERING, 1.0), "unknown": 0.5, "plane": 25.0}
_DRIVEN_MPS, _BOUND_EVERY_S = 3.0, 1.0
_SPEED_KNOWN_S = 2.0
# Of the first reading taken for gravity, and of a gyro's bias as autopilots leave it.
_TILT_SIGMA_RAD, BIAS_SIGMA_RADPS = math.radians(8.0), math.radians(0.2)
# Of roll and pitch where nothing tells them: a component of a unit vector drawn by chance.
UNKNOWN_RAD = 1.0 / math.sqrt(3.0)
# What flies in bends feels its floor, not what is down. And what is known no better is not linear.
_GUESS_RAD, _LINEAR_RAD = {"plane": UNKNOWN_RAD}, math.radians(4.0)
# What (L1) leaves out: sensors that are not quite square to each other.
FLOOR_RAD = math.radians(0.05)
# What whole numbers of a wire, cut toward zero, hide of a rate about zero is like a bias that comes and goes
# with the standing still; what they hide of a force lasts for about a second.
_HIDDEN_RADPS, _HIDDEN_FOR_S, _HIDDEN_MPS2 = 0.001 / math.sqrt(3.0), 10.0, 0.01 / math.sqrt(12.0)
# A gyro's bias wanders; the frame's heading, by the vertical one, too.
_BIAS_WALK, _TURN_WALK = math.radians(0.02) ** 2 / 60.0, math.radians(0.5) ** 2
# What roll and pitch are off by while something moves lasts for about as long as the filter remembers.
LASTS_S = 5.0
# Known to this, the rotation to the receiver's north counts as one.
_TURN_KNOWN = 0.1
# An autopilot's roll and pitch (ArduPilot 4.5.7, hovering or driving: 0.1 degrees whatever its yaw; PX4:
# 0.3), how long an error of it lasts; its noise, and what is not known of the times of its messages. And the
# sine of what its yaw is off by where a compass is bent.
ESTIMATOR_SIGMA_RAD, _ESTIMATOR_MEMORY_S = math.radians(0.2), 10.0
_ESTIMATOR_NOISE_RAD, _ESTIMATOR_LATE_S, _YAW_DOUBT = math.radians(0.05), 0.02, 0.35
# What turns slower is still.
_STILL_RADPS = math.radians(1.5)
# The least noise of a reading, squared; below this share of its variance lies a fourth of what chance shows.
_LEAST_FORCE2, _LEAST_RATE2, _FOURTH = 0.02**2, 0.001**2, 0.288
# Gyros whose scales and axes are off by this much miss so much of a turn.
_SCALE = 0.003
# Compass readings are late: where it pointed in the half second before.
_KEPT_EVERY_S, _KEPT = 0.015, 31
# A measurement farther off than this, in squared sigmas, counts for as much less.
_OUTLIER = 9.0


class Level:
    """Keep which way is down, in body axes, and how well that is known; and the angle turned about it.

    Attributes:
        down: unit vector. turned_rad: about the vertical since the start, clockwise positive, bias taken
            out. rate_radps: of that turn. sigma_rad: of roll and of pitch.
    """

    def __init__(self, vehicle: str = "unknown", longest_step_s: float = 0.5) -> None:
        self.turned_rad = 0.0
        self.rate_radps = 0.0
        self.bias_radps = 0.0
        self._longest_step_s = longest_step_s
        self._upheld = vehicle in UPHELD
        self._bound_mps = _BOUND_MPS.get(vehicle, _DRIVEN_MPS)
        self._guess_rad = _GUESS_RAD.get(vehicle, _TILT_SIGMA_RAD)
        self.restart()

    def restart(self) -> None:
        """Begin anew after a silence or a reboot: the direction of then says nothing of now."""
        self._time_s = self._speed_s = self._unbound_s = -math.inf
        self._drives = False
        # Rows of the rotation from the body to the frame.
        self._x: Vector = (1.0, 0.0, 0.0)
        self._y: Vector = (0.0, 1.0, 0.0)
        self.down: Vector = (0.0, 0.0, 1.0)
        self._acc: Vector = (0.0, 0.0, -_G)
        self._gyro: Vector = (0.0, 0.0, 0.0)
        self._gone: tuple[tuple[Vector, Vector], ...] = ()
        self._past: deque[tuple[float, Vector, float]] = deque(maxlen=_KEPT)
        self._bias: complex = 0.0
        self._v = self._c = self._e = 0.0 + 0.0j
        self._pushed = 0.0 + 0.0j
        self._standing = Standing()
        self._force2, self._rate2 = 0.1**2, math.radians(0.3) ** 2
        self._g_mps2 = _G
        self._misfit, self._put_off2 = 1.0, 0.0
        self._p = _uncorrelated(BIAS_SIGMA_RADPS**2)

    @property
    def time_s(self) -> float:
        """Return the vehicle's time of the latest reading."""
        return self._time_s

    # --- what is asked ------------------------------------------------------------------------------

    @property
    def sigma_rad(self) -> float:
        """Return the sigma of roll and of pitch, each."""
        return math.hypot(math.sqrt(self.variance), FLOOR_RAD)

    @property
    def variance(self) -> float:
        """Return the filter's own variance of roll and of pitch, without what (L1) leaves out."""
        if not is_gravity(self._g_mps2):
            return UNKNOWN_RAD**2
        return max(self._p[_TAU_TAU].real, 1e-10) * max(self._misfit, 1.0)

    def at(self, time_s: float) -> tuple[Vector, float]:
        """Return which way was down, and the angle turned, at a moment of the latest half second."""
        after_s, down, turned = self._time_s, self.down, self.turned_rad
        for before_s, was, had in reversed(self._past):
            if time_s >= after_s:
                break
            if time_s > before_s:
                k = (time_s - before_s) / (after_s - before_s)
                x, y, z = (a + k * (b - a) for a, b in zip(was, down, strict=True))
                return (x, y, z), had + k * (turned - had)
            after_s, down, turned = before_s, was, had
        return down, turned + self.rate_radps * max(min(time_s - after_s, 0.5), -0.5)

    @property
    def is_still(self) -> bool:
        """Tell whether it hardly turns; what seems a gyro's bias, and is none, is a hull that swings."""
        return abs(self.rate_radps) < _STILL_RADPS and abs(self.bias_radps) < 1.5 * BIAS_SIGMA_RADPS

    @property
    def roll_rad(self) -> float:
        """Return the roll."""
        return math.atan2(self.down[1], self.down[2])

    @property
    def pitch_rad(self) -> float:
        """Return the pitch."""
        return math.asin(max(-1.0, min(1.0, -self.down[0])))

    # --- what is heard ------------------------------------------------------------------------------

    def update(self, time_s: float, acc_mps2: Vector, gyro_radps: Vector) -> None:
        """Take one reading; times are the vehicle's, and one that is not later is passed over."""
        step_s = time_s - self._time_s
        if step_s <= 0.0:
            return
        if step_s > self._longest_step_s or not is_gravity(self._g_mps2):
            self._begin(time_s, acc_mps2, gyro_radps)
            return
        if not self._past or self._time_s - self._past[-1][0] > _KEPT_EVERY_S:
            self._past.append((self._time_s, self.down, self.turned_rad))
        acc, gyro = middle(self._acc, acc_mps2), middle(self._gyro, gyro_radps)
        self._note_noise(acc_mps2, gyro_radps)
        changes = changed2(self._acc, acc_mps2, self.down), changed2(self._gyro, gyro_radps, self.down)
        self._time_s, self._acc, self._gyro = time_s, acc_mps2, gyro_radps
        b = self._bias
        azimuth = math.atan2(self._y[0], self._x[0])
        turn = ((gyro[0] - b.real) * step_s, (gyro[1] - b.imag) * step_s, gyro[2] * step_s)
        before = complex(self._x[0] + self._y[1], self._y[0] - self._x[1]) * 0.5
        self._x, self._y, self.down = turned_frame(self._x, self._y, turn)
        after = complex(self._x[0] + self._y[1], self._y[0] - self._x[1]) * 0.5
        raw = dot(gyro_radps, self.down)
        # Standing shows gravity and a gyro's bias; what a receiver sees travel may push and turn as steadily.
        travels = self._drives and time_s - self._speed_s < _SPEED_KNOWN_S
        if abs(raw) < 0.02 and not travels:
            self.bias_radps += min(step_s / 10.0, 1.0) * (raw - self.bias_radps)
        self.rate_radps = raw - self.bias_radps
        turned = math.atan2(self._y[0], self._x[0]) - azimuth
        self.turned_rad += (turned + math.pi) % (2.0 * math.pi) - math.pi - self.bias_radps * step_s
        self._predict(step_s, acc, 0.5 * (before + after), changes)
        if self._upheld:
            self._look_still(step_s, travels)
        if time_s - self._speed_s > _SPEED_KNOWN_S and time_s > self._unbound_s:
            self._unbound_s = time_s + _BOUND_EVERY_S
            self._correct(((_V, 1.0),), -self._v, self._bound_mps**2)

    def hear_velocity(self, moment_s: float, north_mps: float, east_mps: float) -> None:
        """Take a velocity of the satellite receiver, of a moment before the latest reading."""
        since_s = moment_s - self._speed_s
        if not (0.0 < since_s and self._time_s > -math.inf):
            return
        u = complex(north_mps, east_mps)
        self._speed_s, self._drives = moment_s, abs(u) >= 3.0 * RECEIVER_SIGMA_MPS
        r = RECEIVER_SIGMA_MPS**2 * max(_RECEIVER_MEMORY_S / min(max(since_s, 0.05), 1.0), 1.0)
        then = self._v - self._pushed * (self._time_s - moment_s)
        if not self._drives:  # too slow to tell a direction
            self._correct(((_V, 1.0),), -then, r + abs(u) ** 2)
            return
        self._correct(((_V, 1.0), (_C, -u)), self._c * u - then, r, adaptive=True)
        size = abs(self._c)
        if size > 0.5 and self._p[_C_C].real < _TURN_KNOWN**2:  # a rotation is as long as one
            self._correct(((_C, 1.0),), self._c / size - self._c, _TURN_KNOWN**2)

    def hear_attitude(self, time_s: float, roll_rad: float, pitch_rad: float) -> None:
        """Take the autopilot's roll and pitch, of about the moment of the latest reading."""
        later_s = self._time_s - time_s
        if abs(later_s) > self._longest_step_s:
            return
        cp = math.cos(pitch_rad)
        d = (-math.sin(pitch_rad), cp * math.sin(roll_rad), cp * math.cos(roll_rad))
        turned = cross(d, self._gyro)
        d = (d[0] + later_s * turned[0], d[1] + later_s * turned[1], d[2] + later_s * turned[2])
        r = _ESTIMATOR_NOISE_RAD**2 + dot(turned, turned) * _ESTIMATOR_LATE_S**2
        if self._p[_TAU_TAU].real > _LINEAR_RAD**2:
            self._stand(d, ESTIMATOR_SIGMA_RAD**2 + r, -(ESTIMATOR_SIGMA_RAD**2))
            return
        away = complex(dot(self._x, d), dot(self._y, d))
        self._correct(((_TAU, 1.0), (_E, 1.0)), -1j * away - self._e, r)

    # --- the filter ---------------------------------------------------------------------------------

    def _begin(self, time_s: float, acc: Vector, gyro: Vector) -> None:
        turned, bias, biased, known2 = self.turned_rad, self._bias, self.bias_radps, self._p[_B_B]
        g, known = self._g_mps2, min((time_s - self._time_s) / LASTS_S, 1.0)
        self.restart()
        self._bias, self._p = bias, _uncorrelated(known2)
        self.turned_rad, self.bias_radps = turned, biased
        self._time_s, self._acc, self._gyro = time_s, acc, gyro
        self._unbound_s = time_s + _SPEED_KNOWN_S  # a receiver may be about to speak
        norm = math.sqrt(dot(acc, acc))
        self._g_mps2 = g + known * (norm - g)
        down = (0.0, 0.0, 1.0) if norm < 1.0 else (-acc[0] / norm, -acc[1] / norm, -acc[2] / norm)
        self._stand(down, self._guess_rad**2)

    def _stand(self, down: Vector, tau2: float, tau_e: float = 0.0) -> None:
        """Lay the frame anew, this way being down; of what else (L1) has nothing is known but the bias."""
        axis = (1.0, 0.0, 0.0) if abs(down[0]) < 0.9 else (0.0, 1.0, 0.0)
        side = cross(down, axis)
        length = math.sqrt(dot(side, side))
        self._y = (side[0] / length, side[1] / length, side[2] / length)
        self._x, self.down = cross(self._y, down), down
        self.rate_radps = dot(self._gyro, down) - self.bias_radps
        self._v = self._c = self._e = 0.0 + 0.0j
        self._pushed = complex(dot(self._x, self._acc), dot(self._y, self._acc))
        self._p = _uncorrelated(self._p[_B_B], tau2, tau_e)

    def _predict(self, step_s: float, acc: Vector, ahead: complex, changes: Changes) -> None:
        push = complex(dot(self._x, acc), dot(self._y, acc))
        self._pushed += min(step_s / 0.1, 1.0) * (push - self._pushed)
        if self._upheld:
            self._standing = self._standing.feeling(push, step_s)
        g = -dot(self.down, acc)
        # Its mean is gravity's, whatever moves: no climb goes on for ever.
        self._g_mps2 += min(step_s / LASTS_S, 1.0) * (g - self._g_mps2)
        self._v += push * step_s
        fading = math.exp(-step_s / _ESTIMATOR_MEMORY_S)
        self._e *= fading
        # P -> F P F^H + Q, where v' takes lean of tau and bend of b, tau' takes carry of b, and e fades.
        lean, carry = 1j * g * step_s, -ahead * step_s
        bend = 0.5 * lean * carry
        vv, vt, vb, vc, ve, tt, tb, tc, te, bb, bc, be, cc, ce, ee = self._p
        bt, back, turned = tb.conjugate(), carry.conjugate(), tb + carry * bb
        own = vv + lean * vt.conjugate() + bend * vb.conjugate()
        along, across = vt + lean * tt + bend * bt, vb + lean * tb + bend * bb
        # Noise of more than a step averages out what the steps hide. And what changed from one reading to the
        # next did so at any moment between them.
        hidden2 = _HIDDEN_RADPS**2 * _LEAST_RATE2 / self._rate2
        # What it was put off by it takes back by and by.
        self._put_off2 += (1.0 - fading) * ((_YAW_DOUBT * abs(self._pushed) / _G) ** 2 - self._put_off2)
        doubt = ESTIMATOR_SIGMA_RAD**2 + self._put_off2
        step2, ((pushed2, _), (rolled2, yawed2)) = step_s * step_s, changes
        shaken2 = (self._force2 + pushed2 / 12.0) * step2 + _HIDDEN_MPS2**2 * step_s
        scaled2 = _SCALE**2 * dot(self._gyro, self._gyro)
        rolled2 = (self._rate2 + rolled2 / 12.0) * step2 + scaled2 * step_s
        yawed2 = yawed2 / 12.0 * step2 + _TURN_WALK * step_s
        self._p = (
            own + along * lean.conjugate() + across * bend.conjugate() + shaken2,
            along + across * back,
            across,
            vc + lean * tc + bend * bc,
            fading * (ve + lean * te + bend * be),
            tt + carry * bt + turned * back + rolled2,
            turned,
            tc + carry * bc,
            fading * (te + carry * be),
            bb + (_BIAS_WALK + 2.0 * hidden2 / _HIDDEN_FOR_S) * step_s,
            bc,
            fading * be,
            cc + yawed2,
            fading * ce,
            fading * fading * ee + doubt * (1.0 - fading * fading),
        )

    def _correct(
        self, by: tuple[tuple[int, complex], ...], off: complex, r: float, adaptive: bool = False
    ) -> None:
        """Take a measurement of a sum of states by factors: `off` is what it says less what was foreseen."""
        # The innovation's covariance with each state, P h*, and its own variance.
        v = t = b = c = e = 0.0 + 0.0j
        for i, h in by:
            column, h = _column(self._p, i), h.conjugate()
            v, t, b = v + h * column[_V], t + h * column[_TAU], b + h * column[_B]
            c, e = c + h * column[_C], e + h * column[_E]
        row, foreseen = (v, t, b, c, e), 0.0
        for i, h in by:
            foreseen += (h * row[i]).real
        misfit = (off.real**2 + off.imag**2) / (2.0 * (foreseen + r))
        if adaptive:
            self._misfit += 0.05 * (min(misfit, _OUTLIER) - self._misfit)
            r *= max(self._misfit, 1.0)
        r *= max(misfit / _OUTLIER, 1.0)
        by_innovation = 1.0 / (foreseen + r)
        vv, vt, vb, vc, ve, tt, tb, tc, te, bb, bc, be, cc, ce, ee = self._p
        v1, t1, b1, c1 = v * by_innovation, t * by_innovation, b * by_innovation, c * by_innovation
        e1, th, bh, ch, eh = e * by_innovation, t.conjugate(), b.conjugate(), c.conjugate(), e.conjugate()
        self._p = (
            vv - v1 * v.conjugate(), vt - v1 * th, vb - v1 * bh, vc - v1 * ch, ve - v1 * eh,
            tt - t1 * th, tb - t1 * bh, tc - t1 * ch, te - t1 * eh,
            bb - b1 * bh, bc - b1 * ch, be - b1 * eh,
            cc - c1 * ch, ce - c1 * eh,
            ee - e1 * eh,
        )  # fmt: skip
        self._v += v1 * off
        self._c += c1 * off
        self._e += e1 * off
        self._bias += b1 * off
        tau = t1 * off
        # What was felt so far leans with the frame.
        self._pushed += 1j * _G * tau
        self._standing = self._standing.leant(1j * _G * tau)
        x, y = self._x, self._y
        # R -> (1 + [phi]x) R, phi = (tau', tau'', 0): rows x += phi_y z, y -= phi_x z.
        p1, p2 = tau.real, tau.imag
        d = self.down
        self._x, self._y, self.down = squared(
            (x[0] + p2 * d[0], x[1] + p2 * d[1], x[2] + p2 * d[2]),
            (y[0] - p1 * d[0], y[1] - p1 * d[1], y[2] - p1 * d[2]),
        )

    def _look_still(self, step_s: float, travels: bool) -> None:
        """Where what is upheld is still, its specific force is gravity's, but for a push that fades."""
        g = -dot(self.down, self._acc)
        turns = dot(self._gyro, self._gyro) > _STILL_RADPS**2 + 9.0 * self._rate2
        if travels or turns or g < 0.5 * _G:
            self._standing = Standing()
        elif self._standing.felt_s >= LOOK_S:
            felt, variance = self._standing.gravity(self._force2 * step_s / self._standing.felt_s)
            self._standing = self._standing.looked()
            if variance < math.inf:
                self._correct(((_TAU, 1.0),), 1j * felt / g, variance / g**2)

    def _note_noise(self, acc: Vector, gyro: Vector) -> None:
        """Judge how noisy a reading is by third differences, which smooth motion hardly shows."""
        before = self._gone
        self._gone = (*before[-2:], (self._acc, self._gyro))
        if len(self._gone) < 3:
            return
        (a, v), (b, w), (c, x) = self._gone
        force2, rate2 = bend2(a, b, c, acc) / 20.0, bend2(v, w, x, gyro) / 20.0
        self._force2 = max(_calmer(self._force2, force2), _LEAST_FORCE2)
        self._rate2 = max(_calmer(self._rate2, rate2), _LEAST_RATE2)


def _uncorrelated(bias2: complex, tau2: float = UNKNOWN_RAD**2, tau_e: float = 0.0) -> Covariance:
    """Return what is known at a start, with this of the gyro's bias, of the lean, and of it with e."""
    e2, no = ESTIMATOR_SIGMA_RAD**2, 0.0 + 0.0j
    return (30.0**2, no, no, no, no, tau2, no, no, tau_e, bias2, no, no, 1.0, no, e2)


def _column(p: Covariance, i: int) -> tuple[complex, ...]:
    """Return a column of the covariance: of v, tau, c or e, which alone are measured."""
    vv, vt, vb, vc, ve, tt, tb, tc, te, _, bc, be, cc, ce, ee = p
    if i == _V:
        return vv, vt.conjugate(), vb.conjugate(), vc.conjugate(), ve.conjugate()
    if i == _TAU:
        return vt, tt, tb.conjugate(), tc.conjugate(), te.conjugate()
    return (vc, tc, bc, cc, ce.conjugate()) if i == _C else (ve, te, be, ce, ee)


def _calmer(noise2: float, seen2: float) -> float:
    """Follow the variance that the calmer fourth of what is seen has: the rest is motion."""
    return noise2 * (1.02 if seen2 > _FOURTH * noise2 else 0.94)
