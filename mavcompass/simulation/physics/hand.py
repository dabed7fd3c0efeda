"""A person who turns a vehicle by hand: smooth moves with a trembling tilt, and pauses between."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

from mavcompass.simulation.physics.noise import generator


@dataclass(frozen=True, slots=True)
class HandMove:
    """Describe one move.

    Attributes:
        turn_rad: by how much the vehicle is turned, clockwise positive.
        roll_rad, pitch_rad: the tilt in which it is held afterwards, beside the ground's.
        lasts_s: how long the move takes; rests_s: how long it is held still before the next one.
    """

    turn_rad: float
    lasts_s: float = 3.0
    rests_s: float = 5.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0


@dataclass(frozen=True, slots=True)
class HandMotion:
    """Hold what the hands do at one moment: rate of turn, tilt and its rate, and whether they move."""

    yaw_rate_radps: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    roll_rate_radps: float = 0.0
    pitch_rate_radps: float = 0.0
    moving: bool = False


class Hand:
    """Carry out moves one after the other, each by the profile of least jerk."""

    def __init__(self) -> None:
        self._moves: deque[HandMove] = deque()
        self._begun_s = 0.0
        self._at_rest = HandMotion()

    def add(self, moves: Iterable[HandMove], now_s: float) -> None:
        """Plan moves behind those already planned."""
        if not self._moves:
            self._begun_s = now_s
        self._moves.extend(moves)

    def at(self, now_s: float) -> HandMotion:
        """Return the motion at a time; times must not go back."""
        while self._moves and now_s >= self._begun_s + self._moves[0].lasts_s + self._moves[0].rests_s:
            done = self._moves.popleft()
            self._begun_s += done.lasts_s + done.rests_s
            self._at_rest = HandMotion(0.0, done.roll_rad, done.pitch_rad)
        if not self._moves:
            return self._at_rest
        move, roll, pitch = self._moves[0], self._at_rest.roll_rad, self._at_rest.pitch_rad
        share = min((now_s - self._begun_s) / move.lasts_s, 1.0)
        # Minimum jerk: 10 s^3 - 15 s^4 + 6 s^5 and its derivative.
        way = share**3 * (10.0 + share * (-15.0 + 6.0 * share))
        speed = 30.0 * (share * (1.0 - share)) ** 2 / move.lasts_s
        more_roll, more_pitch = move.roll_rad - roll, move.pitch_rad - pitch
        return HandMotion(
            move.turn_rad * speed,
            roll + more_roll * way,
            pitch + more_pitch * way,
            more_roll * speed,
            more_pitch * speed,
            moving=share < 1.0,
        )


def four_turns(seed: int) -> tuple[HandMove, ...]:
    """Draw what a person makes of "four turns of 90 degrees": each 8 degrees off or so, hardly level."""
    rng, tilt_rad = generator(seed, "hand"), math.radians(2.0)
    return tuple(
        HandMove(
            turn_rad=math.radians(90.0 + 8.0 * float(rng.standard_normal())),
            lasts_s=float(rng.uniform(2.0, 4.0)),
            rests_s=float(rng.uniform(4.0, 6.0)),
            roll_rad=tilt_rad * float(rng.uniform(-1.0, 1.0)),
            pitch_rad=tilt_rad * float(rng.uniform(-1.0, 1.0)),
        )
        for _ in range(4)
    )
