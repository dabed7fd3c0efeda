"""What to record next: which motion would tell the rivals apart, predicted with the registry itself."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mavcompass.frames import FloatArray, euler_to_matrix
from mavcompass.gap.attitude.reference import body_rate
from mavcompass.gap.fit.hypothesis import Fit, Term, make_term
from mavcompass.gap.replay.noise import Noise
from mavcompass.gap.result import Flight
from mavcompass.simulation.effects import Setting
from mavcompass.simulation.effects.effect import Distortion, Signals
from mavcompass.simulation.physics.signals import Stimulus, ideal

_RATE_HZ = 10.0


# Recordings that somebody could make, and for how many minutes.
PROTOCOLS = {
    "four turns of 90 degrees with 5 s dwells, level": 0.6,
    "slow tumble through all attitudes": 1.0,
    "figures of eight with bank": 1.0,
    "spins at 20 and 120 degrees per second, both ways": 0.7,
    "throttle pulses at a fixed heading": 0.7,
    "warm up and cool down while tumbling": 4.0,
    "pass the place again on three headings": 1.5,
}


def next_flights(
    rivals: Sequence[tuple[frozenset[str], Fit]], field_ned_mgauss: FloatArray, noise: Noise
) -> tuple[Flight, ...]:
    """Rank protocols by the least separation, in sigmas, between the likeliest explanation and each rival.

    Each rival is refitted (linearly) to what the likeliest would make; the list is sorted by the
    separation per square root of a minute, since it grows with the root of time.
    """
    if len(rivals) < 2:
        return ()
    names = tuple(sorted(set().union(*(ids for ids, _ in rivals))))
    found = []
    for name, minutes in PROTOCOLS.items():
        signals = _signals(name, minutes, field_ned_mgauss)
        truth = Distortion(_settings(rivals[0][1])).run(signals, None).reading.mag_mgauss
        distances = [_distance(signals, truth, fit, noise) for _, fit in rivals[1:4]]
        least = min(distances)
        if math.isfinite(least) and least > 0.5:
            found.append((least / math.sqrt(minutes), Flight(name, names, least)))
    found.sort(key=lambda item: -item[0])
    return tuple(flight for _, flight in found[:4])


def _settings(fit: Fit) -> list[Setting]:
    return [Setting(t.effect, x) for t, x in zip(fit.terms, fit.thetas, strict=True)]


def _distance(signals: Signals, truth: FloatArray, rival: Fit, noise: Noise) -> float:
    """Return the whitened distance of the truth to the nearest that a rival can make."""
    sigma = noise["mag"].rms
    rate = float(np.sqrt((1.0 - min(float(noise["mag"].coefficients.sum(axis=0).mean()), 0.95)) * 0.5 + 0.5))
    settings = _settings(rival)
    terms: list[Term] = [make_term(t.effect, signals) for t in rival.terms]
    base = Distortion(settings).run(signals, None).reading.mag_mgauss
    columns = []
    for i, (term, setting) in enumerate(zip(terms, settings, strict=True)):
        for j in np.flatnonzero(term.free):
            step = 1e-3 * term.effect.parameters[j].scale
            theta = setting.theta.copy()
            theta[j] += step
            moved = [*settings[:i], replace(setting, theta=theta), *settings[i + 1 :]]
            made = Distortion(moved).run(signals, None).reading.mag_mgauss
            columns.append(((made - base) / step / sigma).ravel())
    difference = ((truth - base) / sigma).ravel()
    if columns:
        J = np.stack(columns, axis=1)
        size = np.sqrt(np.maximum((J**2).sum(axis=0), 1e-300))
        solution, *_ = np.linalg.lstsq(J / size, difference, rcond=1e-8)
        difference = difference - (J / size) @ solution
    return float(np.sqrt(difference @ difference)) * rate


def _signals(name: str, minutes: float, field: FloatArray) -> Signals:
    n = round(60.0 * minutes * _RATE_HZ)
    t = np.arange(n) / _RATE_HZ
    u = t / t[-1]
    roll, pitch, yaw = np.zeros(n), np.zeros(n), np.zeros(n)
    throttle, temperature = np.full(n, 0.3), np.full(n, 25.0)
    position = np.zeros((n, 3))
    if name.startswith("four"):
        phase = 4.0 * u
        part = np.clip((phase % 1.0) * 9.0 - 5.0, 0.0, 4.0) / 4.0
        yaw = 0.5 * math.pi * (np.floor(phase) + part)
    elif name.startswith("figures"):
        yaw = 4.0 * np.sin(2.0 * math.pi * t / 20.0)
        roll = 0.35 * np.sin(2.0 * math.pi * t / 20.0 + 1.0)
    elif name.startswith("spins"):
        rate = np.where(u < 0.25, 20.0, np.where(u < 0.5, -20.0, np.where(u < 0.75, 120.0, -120.0)))
        yaw = np.radians(np.cumsum(rate) / _RATE_HZ)
    elif name.startswith("throttle"):
        throttle = 0.2 + 0.5 * (np.floor(t / 3.0) % 2)
    elif name.startswith("pass"):
        leg = 3.0 * u
        # Turning takes the last fifth of each leg: nobody turns within a reading.
        part = np.clip(5.0 * (leg % 1.0) - 4.0, 0.0, 1.0)
        yaw = 2.1 * (np.floor(leg) + part**2 * (3.0 - 2.0 * part))
        along = 8.0 * (leg % 1.0) - 4.0
        position = np.stack([along * np.cos(yaw), along * np.sin(yaw), 0.0 * t], axis=1)
    else:
        roll, pitch = 0.8 * np.sin(2.0 * math.pi * t / 13.0), 0.7 * np.sin(2.0 * math.pi * t / 9.0)
        yaw = 2.0 * math.pi * t / 25.0
        if name.startswith("warm"):
            temperature = 25.0 + 20.0 * np.sin(math.pi * u)
    rotation = euler_to_matrix(roll, pitch, yaw)
    stimulus = Stimulus.posed(
        t, rotation, field, rate_radps=body_rate(t, rotation), position_ned_m=position, throttle=throttle,
        current_a=1.0 + 28.0 * throttle**1.5, temperature_degc=temperature,
        motors=np.repeat(throttle[:, None], 4, axis=1),
    )  # fmt: skip
    return Signals(stimulus, ideal(stimulus))
