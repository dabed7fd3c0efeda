"""Cases of others, vehicles of another make and another simulator, as the trial seals and scores them.

Another simulator's columns become tracks by the contract and nothing else.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.trial.cases import SHARES, Generator, Label, Tier
from mavcompass.gap.trial.closed_form import UTC_S, Simulated, make, quaternion
from mavcompass.gap.trial.vehicles import VehicleCase, make_case
from mavcompass.simulation.effects import catalogue
from mavcompass.track import MagSeries, Series, Track

_COUNTS = {"none": 0, "single": 1, "pair": 2}
# Columns of the contract's Track CSV and where a track has them.
_VECTORS = {
    "acc_mps2": tuple(f"acc_{axis}_mps2" for axis in "xyz"),
    "gyro_radps": tuple(f"gyro_{axis}_radps" for axis in "xyz"),
    "attitude_rad": ("roll_rad", "pitch_rad", "yaw_rad"),
    "reference_q": ("ref_qw", "ref_qx", "ref_qy", "ref_qz"),
    "position_ned_m": ("pos_n_m", "pos_e_m", "pos_d_m"),
    "place": ("lat_deg", "lon_deg", "alt_m"),
}
_SCALARS = ("current_a", "throttle", "temperature_degc")


def another_case(seed: int, tier: str) -> VehicleCase:
    """Make the case of a seed: none, one or two effects, with a flight of the same vehicle before."""
    made = make(seed, _COUNTS[tier])
    flight = made.flight
    return VehicleCase(
        track=_track(flight, "flight"),
        baseline=_track(made.baseline, "baseline"),
        effects=made.effects,
        clean_nominal_mgauss=flight.plain_mgauss,
        clean_mgauss=flight.raw_mgauss,
        words=f"another simulator {made.words}",
    )


def _track(simulated: Simulated, name: str) -> Track:
    columns, time_s = simulated.columns, simulated.time_s

    def stacked(names: tuple[str, ...]) -> FloatArray:
        return np.stack([columns[column] for column in names], axis=1)

    found = {key: Series.of(time_s, stacked(names)) for key, names in _VECTORS.items() if names[0] in columns}
    found |= {key: Series.of(time_s, columns[key]) for key in _SCALARS}
    mag = Series.of(time_s, stacked(tuple(f"mag_{axis}_mgauss" for axis in "xyz")))
    return Track(
        source=name,
        compasses={1: MagSeries(1, mag, correction_known=False)},
        gps_velocity_mps=Series.of(time_s, simulated.velocity_mps),
        truth_q=Series.of(time_s, np.stack(quaternion(simulated.angles_rad), axis=1)),
        utc_offset_s=UTC_S,
        **found,  # type: ignore[arg-type]
    )


def case_of(generator: Generator, tier: Tier, seed: int) -> VehicleCase:
    """Make the case of a label: one whose cause is withheld is a single one."""
    if generator == "another":
        return another_case(seed, tier)
    return make_case(seed, "single" if tier == "withheld" else tier)


def shifts(names: Iterable[str]) -> bool:
    """Tell whether all of these effects move the readings, rather than scatter or repeat them."""
    every = catalogue()
    return all(name not in every or every[name].kind in ("mean", "discrete") for name in names)


def draw_case(generator: Generator, seed: int, index: int, tier: Tier | None) -> tuple[Label, Track, Track]:
    """Draw one case: its label, the recording and the baseline."""
    rng = np.random.default_rng([seed, index, 78])
    shares = SHARES[generator]
    chosen: Tier = tier or rng.choice(list(shares), p=list(shares.values()))
    while True:
        own = int(rng.integers(2**31))
        case = case_of(generator, chosen, own)
        # Without the cause that leaves only a trace, there is nothing left to be flagged.
        if chosen != "withheld" or shifts(name for name, _ in case.effects):
            break
    effects = tuple(
        f"{name}:" + ",".join(f"{key}={value:.9g}" for key, value in values.items())
        for name, values in case.effects
    )
    label = Label(chosen, case.words, own, effects, generator=generator)
    assert case.baseline is not None
    return label, case.track, case.baseline
