"""The heading by one compass of a recording, sample by sample, with what its readings leave unknown of it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.attitude import levels
from mavcompass.compass_parameters import is_calibrated
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField, earth_field_of, middle_place
from mavcompass.errors import BadRecording
from mavcompass.frames import FloatArray, tilt_from_acceleration, wrap_two_pi
from mavcompass.gravity import require_gravity
from mavcompass.heading.compute import (
    grid_heading,
    level_field,
    tilt_compensated_heading,
    true_heading,
    two_axis_heading,
)
from mavcompass.heading.doubt import (
    TILT_SIGMA_RAD,
    CalibrationDoubt,
    prior_sigma_mgauss,
    turned_since_new,
)
from mavcompass.heading.true_north import TrueNorth
from mavcompass.track import Track

# The date of a recording that does not tell it: the middle of WMM2025's years.
UNKNOWN_YEAR = 2027.5


@dataclass(frozen=True, slots=True, eq=False)
class HeadingResult:
    """Hold headings over time, (N,) each, radians in [0, 2 pi).

    Attributes:
        time_s: the compass's readings.
        magnetic_rad: from magnetic north. true_rad, grid_rad: from true and UTM grid north; None where
            the recording does not tell its place.
        magnetic_sigma_rad, sigma_rad: standard deviation of the magnetic heading, and of the true one
            (the declination's included; of the magnetic one again where the place is unknown). The
            calibration's share is judged by how far the corrected field is from the Earth's.
        north: what the true heading rests on; None where there is none, or nothing else was looked at.
    """

    time_s: FloatArray
    magnetic_rad: FloatArray
    magnetic_sigma_rad: FloatArray
    sigma_rad: FloatArray
    true_rad: FloatArray | None = None
    grid_rad: FloatArray | None = None
    declination_rad: float = math.nan
    north: TrueNorth | None = None

    def widened(self, beyond_rad: float, true_beyond_rad: float | None = None) -> HeadingResult:
        """Return it with what is not known beyond the sigmas, rms; of true headings that may be another."""
        true_rad = beyond_rad if true_beyond_rad is None else true_beyond_rad
        magnetic = np.minimum(np.hypot(self.magnetic_sigma_rad, beyond_rad), math.pi)
        true = np.minimum(np.hypot(self.sigma_rad, true_rad), math.pi)
        return replace(self, magnetic_sigma_rad=magnetic, sigma_rad=true)

    def with_north(self, north: TrueNorth) -> HeadingResult:
        """Return it with true headings by another angle from magnetic north than the model's."""
        more = north.turn_rad - self.declination_rad
        true, grid = (None if h is None else wrap_two_pi(h + more) for h in (self.true_rad, self.grid_rad))
        model = north.world.declination_sigma_rad
        sigma = np.sqrt(np.maximum(self.sigma_rad**2 - model**2, 0.0) + north.sigma_rad**2)
        return replace(self, true_rad=true, grid_rad=grid, sigma_rad=np.minimum(sigma, math.pi), north=north)


def heading_by_compass(
    track: Track, correction: FieldCorrection | None = None, instance: int = 1, two_axis: bool = False
) -> HeadingResult:
    """Compute the tilt-compensated heading by one compass; see `evidence.heading_of_track`."""
    compass = track.compass(instance)
    require_gravity(track.acc_mps2)
    world = earth_field_of(track, UNKNOWN_YEAR)
    field, calibrated = _field(track, correction, instance)
    level = levels(track)
    down, leaning = level.at(compass.time_s), level.sigma_rad.at(compass.time_s)
    roll, pitch = tilt_from_acceleration(-down)
    if two_axis:
        if world is None:
            raise BadRecording(
                "A two-axis heading needs the Earth's field, and the recording does not tell its place.",
                "Use a recording with GPS, or all three axes.",
            )
        magnetic = np.asarray(
            two_axis_heading(field[:, :2], roll, pitch, world.total_mgauss, world.inclination_rad)
        )
    else:
        magnetic = np.asarray(tilt_compensated_heading(field, -down))
    late = turned_since_new(track, instance)
    sigma = _magnetic_sigma(field, down, leaning, magnetic, world, calibrated, two_axis, late)
    sigma[track.saturated(instance)] = math.pi
    found = HeadingResult(compass.time_s, magnetic, sigma, sigma)
    if world is None:
        return found
    true, grid = np.asarray(true_heading(magnetic, world)), None
    if track.place is not None and len(track.place):
        lat, lon, _ = middle_place(track.place.values)
        grid = np.asarray(grid_heading(true, lat, lon))
    sigma = np.hypot(sigma, world.declination_sigma_rad)
    return replace(
        found, sigma_rad=sigma, true_rad=true, grid_rad=grid, declination_rad=world.declination_rad
    )


def _field(track: Track, correction: FieldCorrection | None, instance: int) -> tuple[FloatArray, bool]:
    """Return a compass's field, and whether it is by a calibration; not where the recording does not tell."""
    if correction is None:
        in_force = track.compasses[instance].calibration
        known = in_force is not None and is_calibrated(track.autopilot, track.parameters, instance, in_force)
        return track.corrected_field(instance), known
    load = track.load_of(correction, track.compasses[instance].time_s)
    return correction.apply(track.raw_field(instance), load), any(correction.offsets_mgauss)


def _magnetic_sigma(
    field: FloatArray,
    down: FloatArray,
    leaning: FloatArray,
    magnetic: FloatArray,
    world: EarthField | None,
    calibrated: bool,
    two_axis: bool,
    late: FloatArray | float = 0.0,
) -> FloatArray:
    """Add up calibration, scatter, lateness, tilt by the dip's tangent, and (two-axis) the estimated Z."""
    vertical = np.einsum("ij,ij->i", field, down)
    horizontal = np.sqrt(np.maximum((field**2).sum(axis=1) - vertical**2, 1.0))
    usual = world.horizontal_mgauss if world is not None else float(np.median(horizontal))
    level = level_field(magnetic, horizontal, vertical)
    doubt = CalibrationDoubt(prior_sigma_mgauss(calibrated, usual), world)
    doubt.add_all(level)
    steep = np.full(len(field), abs(world.ned_mgauss[2])) if world is not None else np.abs(vertical)
    z_sigma = np.zeros(len(field))
    if two_axis and world is not None:
        root = np.maximum(np.abs(field[:, 2]), 0.05 * world.total_mgauss)
        z_sigma = math.hypot(*world.sigma_mgauss) * world.total_mgauss / root
    tilt = np.hypot(down[:, 0], down[:, 1])
    leaning = np.hypot(leaning, TILT_SIGMA_RAD)
    noise = np.hypot(z_sigma * tilt, doubt.scatter_mgauss)
    square = doubt.sigma_rad(level[:, 0], level[:, 1]) ** 2 + np.square(late)
    square += (noise / max(usual, 1e-9)) ** 2 + (steep / max(usual, 1e-9) * leaning) ** 2
    return np.asarray(np.minimum(np.sqrt(square), math.pi))
