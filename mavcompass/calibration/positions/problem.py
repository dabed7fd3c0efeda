"""What a four-position fit starts from: measurements with their covariances, the prior, a first state."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from mavcompass.calibration.model import (
    GAIN,
    GYRO_BIAS,
    GYRO_SCALE,
    HEADINGS,
    HORIZONTAL,
    MOTOR,
    OFFSET,
    VERTICAL,
    by_tilt,
    gain_matrix,
    gain_parameters,
    level_to_body,
)
from mavcompass.calibration.observation import FourPositionData, Step
from mavcompass.correction import FieldCorrection
from mavcompass.earth_field import EarthField
from mavcompass.errors import PoorCalibration
from mavcompass.frames import FloatArray

# What no error model names: the sensor's own bends and steps of its converter.
_FLOOR_MGAUSS = 0.01


@dataclass(frozen=True, slots=True)
class IronPrior:
    """State what is known of a compass before the vehicle turns.

    Attributes:
        gain_sigma: of each horizontal gain about 1.
        vertical_gain_sigma: of the vertical gain about the mean of the horizontal ones.
        cross_sigma: of the cross terms, where there are any. own_cross_sigma: of a sensor's own without iron:
            axes are square, and set to the vehicle's, within a third of a degree.
        site_sigma_mgauss: what rocks, buildings and parked cars add to the world model, each component.
        motor_sigma_mgauss_per_a: of the field of the battery current, each axis.
        vertical_offset_sigma_mgauss: of the offset in force on Z, where there is no world model.
    """

    gain_sigma: float = 0.25
    vertical_gain_sigma: float = 0.05
    cross_sigma: float = 0.04
    own_cross_sigma: float = 0.005
    site_sigma_mgauss: float = 5.0
    motor_sigma_mgauss_per_a: float = 0.5
    vertical_offset_sigma_mgauss: float = 100.0


DEFAULT_PRIOR = IronPrior()


@dataclass(frozen=True, slots=True, eq=False)
class PositionProblem:
    """Hold the measurements in the form the fit works on."""

    mean: FloatArray  # (K, 3)
    whiten: FloatArray  # (K, 3, 3), maps residuals to unit variance
    noise: FloatArray  # (K, 3, 3) and so on: the parts of the residuals' covariance
    quantisation: FloatArray
    tilt: FloatArray
    leaning: FloatArray  # (K, 3, 2): one sigma of the accelerometer's error, common to all, in the field
    level_to_body: FloatArray  # (K, 3, 3)
    coherence: FloatArray  # (K,)
    current: FloatArray  # (K,), less its mean; zeros where unknown
    steps: FloatArray  # (K-1,) and their sigma and duration
    step_sigma: FloatArray
    step_duration: FloatArray
    centre: FloatArray  # (P,), the prior's mean and sigma; sigma inf = no prior
    sigma: FloatArray
    vertical_gain_sigma: float
    start: FloatArray  # (P,)
    mirrored: bool

    @classmethod
    def of(
        cls, data: FourPositionData, in_force: FieldCorrection, earth: EarthField | None, prior: IronPrior
    ) -> PositionProblem:
        """Prepare the fit: the start by linear least squares, the weights, the prior."""
        dwells = data.dwells
        if len(dwells) < 3:
            raise PoorCalibration(
                f"Only {len(dwells)} still positions: offset and amplitude need at least three.",
                "Turn the vehicle in four steps of about 90 degrees and stop after each.",
            )
        mean = np.array([d.mean_mgauss for d in dwells])
        tilts = level_to_body([d.roll_rad for d in dwells], [d.pitch_rad for d in dwells])
        coherence = np.array([d.coherence for d in dwells])
        current = np.array([d.current_a for d in dwells])
        current = current - current.mean() if np.isfinite(current).all() else np.zeros(len(dwells))
        start, mirrored = _start(mean, tilts, data.turned_rad, earth, in_force)
        centre, sigma = _prior_vectors(start, len(dwells), data, in_force, earth, prior)
        noise = np.array([d.covariance_mgauss2 for d in dwells]) + _FLOOR_MGAUSS**2 * np.eye(3)
        quantisation = np.array([d.quantisation_mgauss2 for d in dwells])
        leaning = by_tilt(tilts, start, start[HEADINGS:])
        sigma2 = np.array([d.tilt_sigma_rad for d in dwells])[:, np.newaxis, np.newaxis] ** 2
        tilt = leaning @ np.swapaxes(leaning, 1, 2) * sigma2
        factor = np.linalg.cholesky(noise + quantisation + tilt)
        return cls(
            mean=mean,
            whiten=np.linalg.inv(factor),
            noise=noise,
            quantisation=quantisation,
            tilt=tilt,
            leaning=leaning * data.tilt_bias_sigma_rad,
            level_to_body=tilts,
            coherence=coherence,
            current=current,
            steps=np.array([s.angle_rad for s in data.steps]),
            step_sigma=np.array([max(s.sigma_rad, 1e-6) for s in data.steps]),
            step_duration=np.array([s.duration_s for s in data.steps]),
            centre=centre,
            sigma=sigma,
            vertical_gain_sigma=prior.vertical_gain_sigma,
            start=start,
            mirrored=mirrored,
        )

    def loosened(self, index: int, size_mgauss: float) -> PositionProblem:
        """Let one dwell's field be off by an unknown amount of that size, each axis."""
        noise = self.noise.copy()
        noise[index] += size_mgauss**2 * np.eye(3)
        whiten = self.whiten.copy()
        covariance = noise[index] + self.quantisation[index] + self.tilt[index]
        whiten[index] = np.linalg.inv(np.linalg.cholesky(covariance))
        return replace(self, noise=noise, whiten=whiten)

    def with_pose(
        self, state: FloatArray, turn_rad: float, roll_rad: float, pitch_rad: float, step: Step
    ) -> PositionProblem:
        """Add a pose not yet taken, as certain as the best so far, reading what `state` predicts."""
        tilt = level_to_body(roll_rad, pitch_rad)
        psi = float(state[-1]) + turn_rad
        horizontal = float(state[HORIZONTAL])
        level = np.array([horizontal * math.cos(psi), -horizontal * math.sin(psi), float(state[VERTICAL])])
        reading = state[OFFSET] + gain_matrix(state[GAIN]) @ tilt @ level
        best = int(np.argmin(np.trace(self.noise + self.quantisation + self.tilt, axis1=1, axis2=2)))

        def grown(array: FloatArray, value: FloatArray) -> FloatArray:
            return np.concatenate([array, np.asarray(value)[np.newaxis]])

        return replace(
            self,
            mean=grown(self.mean, reading),
            level_to_body=grown(self.level_to_body, tilt),
            coherence=grown(self.coherence, np.array(1.0)),
            current=grown(self.current, np.array(0.0)),
            steps=grown(self.steps, np.array(turn_rad)),
            step_sigma=grown(self.step_sigma, np.array(max(step.sigma_rad, 1e-6))),
            step_duration=grown(self.step_duration, np.array(step.duration_s)),
            centre=grown(self.centre, np.array(0.0)),
            sigma=grown(self.sigma, np.array(np.inf)),
            start=grown(state, np.array(psi)),
            whiten=grown(self.whiten, self.whiten[best]),
            noise=grown(self.noise, self.noise[best]),
            quantisation=grown(self.quantisation, self.quantisation[best]),
            tilt=grown(self.tilt, self.tilt[best]),
            leaning=grown(self.leaning, self.leaning[best]),
        )


def _start(
    mean: FloatArray,
    tilts: FloatArray,
    turned: FloatArray,
    earth: EarthField | None,
    in_force: FieldCorrection,
) -> tuple[FloatArray, bool]:
    """Fit r = c + p cos(turned) + q sin(turned) per axis and read a first state off it.

    With psi = psi_1 + turned the horizontal part is H T F(psi_1), F a reflection; a positive
    determinant of (p, q) means that the field turns the wrong way.
    """
    design = np.stack([np.ones(turned.size), np.cos(turned), np.sin(turned)], axis=1)
    singular = np.linalg.svd(design, compute_uv=False)
    if singular[-1] < 0.12 * math.sqrt(turned.size):
        degrees = math.degrees(float(np.ptp(turned)))
        raise PoorCalibration(
            f"The positions cover too little of the circle: {degrees:.0f} degrees of turning in all.",
            "Turn the vehicle in four steps of about 90 degrees and stop after each.",
        )
    line, *_ = np.linalg.lstsq(design, mean, rcond=None)
    plane = line[1:, :2].T
    amplitude = float(np.sqrt(abs(np.linalg.det(plane))))
    if amplitude < 1.0:
        raise PoorCalibration(
            f"The field hardly changes while the vehicle turns (amplitude {amplitude:.1f} mG): this compass "
            "is dead, frozen or reads only its offsets.",
            "Check the compass's wiring and that COMPASS_USE and the driver see the sensor.",
        )
    mirrored = float(np.linalg.det(plane)) > 0.0
    horizontal = earth.horizontal_mgauss if earth is not None else amplitude
    vertical = earth.ned_mgauss[2] if earth is not None else float(in_force.apply(mean).mean(axis=0)[2])
    if mirrored:
        plane = plane * np.array([[1.0], [-1.0]])
    left, values, right = np.linalg.svd(plane / horizontal)
    gain = left @ np.diag(values) @ left.T
    reflection = left @ right
    state = np.zeros(HEADINGS + turned.size)
    state[GAIN] = gain_parameters(np.block([[gain, np.zeros((2, 1))], [np.zeros((1, 2)), np.eye(1)]]))
    state[GAIN][2] = 0.5 * (gain[0, 0] + gain[1, 1])
    state[HORIZONTAL], state[VERTICAL] = horizontal, vertical
    first = math.atan2(-reflection[1, 0], reflection[0, 0])
    state[HEADINGS:] = first + turned
    state[OFFSET] = line[0] - gain_matrix(state[GAIN]) @ tilts.mean(axis=0) @ [0.0, 0.0, vertical]
    return state, mirrored


def _prior_vectors(
    start: FloatArray,
    dwells: int,
    data: FourPositionData,
    in_force: FieldCorrection,
    earth: EarthField | None,
    prior: IronPrior,
) -> tuple[FloatArray, FloatArray]:
    centre = np.zeros(HEADINGS + dwells)
    sigma = np.full(HEADINGS + dwells, np.inf)
    centre[GAIN] = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
    sigma[GAIN] = (prior.gain_sigma, prior.gain_sigma, np.inf, *(3 * [prior.cross_sigma]))
    sigma[GYRO_SCALE] = max(data.gyro_scale_sigma, 1e-9)
    sigma[GYRO_BIAS] = max(data.gyro_bias_sigma_radps, 1e-9)
    sigma[MOTOR] = prior.motor_sigma_mgauss_per_a
    centre[HORIZONTAL], centre[VERTICAL] = start[HORIZONTAL], start[VERTICAL]
    if earth is not None:
        north, east, down = earth.sigma_mgauss
        declination = earth.declination_rad
        along = math.hypot(north * math.cos(declination), east * math.sin(declination))
        sigma[HORIZONTAL] = math.hypot(along, prior.site_sigma_mgauss)
        sigma[VERTICAL] = math.hypot(down, prior.site_sigma_mgauss)
    else:
        sigma[HORIZONTAL] = 0.5 * start[HORIZONTAL]
        sigma[VERTICAL] = max(0.5 * abs(start[VERTICAL]), 50.0)
        centre[2] = -in_force.offsets_mgauss[2]
        sigma[2] = prior.vertical_offset_sigma_mgauss
    return centre, sigma
