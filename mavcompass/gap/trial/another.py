"""Cases of another simulator for the blind trial: its columns as tracks, by the contract and nothing else."""

from __future__ import annotations

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.trial.closed_form import UTC_S, Simulated, make
from mavcompass.gap.trial.closed_form.formulas import quaternion
from mavcompass.gap.trial.vehicles import VehicleCase
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


def make_case(seed: int, tier: str) -> VehicleCase:
    """Make the case of a seed: none, one or two effects, with a flight of the same vehicle before."""
    made = make(seed, _COUNTS[tier])
    flight = made.flight
    return VehicleCase(
        track=_track(flight, "flight"),
        baseline=_track(made.baseline, "baseline"),
        effects=made.effects,
        clean_nominal_mgauss=flight.plain_mgauss,
        clean_mgauss=flight.raw_mgauss,
        description={"vehicle": "another simulator", "motion": made.words},
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
