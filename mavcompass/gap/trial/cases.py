"""Recordings with a known cause, for the self-examination: labels, motion, sensors, noise and effects.

The bench's motions are three: level turns in steps of 90 degrees with dwells; figures of eight with some
bank; a rich one that tumbles, works the throttle, warms up and cools down, and moves about. Cases of others
are vehicles of another make, and another simulator's: its columns become tracks by the contract alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, cast, get_args

import numpy as np

from mavcompass.frames import FloatArray, euler_to_matrix, euler_to_quaternion
from mavcompass.gap.attitude.reference import body_rate
from mavcompass.gap.replay.noise import Noise, SensorNoise, group_values
from mavcompass.gap.trial import closed_form
from mavcompass.gap.trial.vehicles import VehicleCase, make_case
from mavcompass.simulation.effects import Distortion, Effect, Setting, catalogue, parse, spell
from mavcompass.simulation.effects.effect import GROUPS, MOMENTS, Group, Parameter, Stage
from mavcompass.simulation.physics.signals import Reading, Stimulus, ideal
from mavcompass.track import MagSeries, Series, Track

Generator = Literal["bench", "vehicles", "another"]
Tier = Literal["none", "single", "pair", "withheld", "outside"]
GENERATORS: tuple[Generator, ...] = get_args(Generator)
TIERS: tuple[Tier, ...] = get_args(Tier)
SHARES: dict[Generator, dict[Tier, float]] = {
    "bench": {"none": 0.35, "single": 0.35, "pair": 0.15, "withheld": 0.15},
    "vehicles": {"none": 0.3, "single": 0.3, "pair": 0.15, "withheld": 0.1, "outside": 0.15},
    "another": {"none": 0.3, "single": 0.5, "pair": 0.2},
}
Motion = Literal["yaw-steps", "figure-8", "rich"]
MOTIONS: tuple[Motion, ...] = ("yaw-steps", "figure-8", "rich")
PLACE = (47.3977, 8.5456, 488.0)
UTC_S = 1_780_272_000.0
_NOISE: dict[Group, tuple[float, float]] = {"mag": (3.0, 0.3), "acc": (0.03, 0.0), "gyro": (0.003, 0.0)}
# The same as a diagnosis has it: standard deviation and first-order correlation of each sensor.
CASE_NOISE: Noise = {
    group: SensorNoise(
        np.full((1 if rho else 0, 3), rho),
        np.full(3, sigma * math.sqrt(1.0 - rho**2)),
        np.full(3, sigma),
        6000.0,
    )
    for group, (sigma, rho) in _NOISE.items()
}


@dataclass(frozen=True, slots=True)
class Label:
    """Hold what is true of a case: tier, motion, the effects as `NAME:param=value,...`, their size in sigmas.

    The size is nan where it is only known beside the diagnosis's own noise (vehicles), until it is scored.
    """

    tier: Tier
    motion: str
    seed: int
    effects: tuple[str, ...]
    size_sigma: float = math.nan
    generator: Generator = "bench"

    @property
    def ids(self) -> tuple[str, ...]:
        """Return the names of the effects, sorted."""
        return tuple(sorted(text.partition(":")[0] for text in self.effects))


@dataclass(frozen=True, slots=True)
class Recipe:
    """Say how to make a recording: motion, length, rate, seed."""

    motion: Motion = "rich"
    duration_s: float = 100.0
    rate_hz: float = 20.0
    seed: int = 0


def _smooth(time_s: FloatArray, rng: np.random.Generator, slowest_s: float, fastest_s: float) -> FloatArray:
    """Return a smooth random function of unit rms: six sines between two periods."""
    period = np.exp(rng.uniform(math.log(fastest_s), math.log(slowest_s), 6))
    phase = rng.uniform(0.0, 2.0 * math.pi, 6)
    waves = np.sin(2.0 * math.pi * time_s[:, None] / period + phase)
    return np.asarray(waves.sum(axis=1) / math.sqrt(3.0))


def _angles(recipe: Recipe, t: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, ...]:
    if recipe.motion == "yaw-steps":
        dwell, turn = rng.uniform(4.0, 7.0), rng.uniform(2.0, 3.5)
        phase = t / (dwell + turn)
        part = np.clip((phase % 1.0 * (dwell + turn) - dwell) / turn, 0.0, 1.0)
        yaw = 0.5 * math.pi * (np.floor(phase) + part**3 * (10.0 - 15.0 * part + 6.0 * part**2))
        tilt = rng.normal(0.0, math.radians(0.7), 2)
        return tilt[0] + np.zeros_like(t), tilt[1] + np.zeros_like(t), yaw + rng.uniform(0.0, 6.0)
    if recipe.motion == "figure-8":
        period = rng.uniform(16.0, 24.0)
        rate = 2.0 * math.pi / period
        yaw = 1.25 * math.pi * np.sin(rate * t + rng.uniform(0.0, 6.0)) + 0.03 * t
        bank = math.radians(18.0) * np.sin(rate * t + rng.uniform(0.0, 6.0))
        pitch = math.radians(6.0) * _smooth(t, rng, 15.0, 5.0)
        return bank, pitch, yaw
    roll = math.radians(28.0) * _smooth(t, rng, 20.0, 4.0)
    pitch = math.radians(22.0) * _smooth(t, rng, 20.0, 4.0)
    yaw = rng.choice([-1.0, 1.0]) * 0.35 * t + 1.0 * _smooth(t, rng, 30.0, 5.0)
    return roll, pitch, yaw


def _stimulus(recipe: Recipe, field: FloatArray, rng: np.random.Generator) -> Stimulus:
    n = round(recipe.duration_s * recipe.rate_hz)
    t = np.arange(n) / recipe.rate_hz
    rotation = euler_to_matrix(*_angles(recipe, t, rng))
    rich = recipe.motion == "rich"
    throttle = np.full(n, 0.4)
    temperature = np.full(n, 25.0)
    position = np.zeros((n, 3))
    motors = np.repeat(throttle[:, None], 4, axis=1)
    if rich:
        throttle = np.clip(0.45 + 0.25 * _smooth(t, rng, 15.0, 2.0), 0.0, 1.0)
        shares = np.stack([_smooth(t, rng, 12.0, 2.0) for _ in range(4)], axis=1)
        motors = np.clip(throttle[:, None] + 0.12 * (shares - shares.mean(axis=1, keepdims=True)), 0.0, 1.0)
        temperature = 25.0 + 12.0 * np.sin(math.pi * t / recipe.duration_s) ** 2 + 0.05 * t
        position = np.stack([2.0 * _smooth(t, rng, 40.0, 15.0) for _ in range(3)], axis=1)
        position[:, 2] *= 0.4
    current = 1.0 + 28.0 * throttle**1.5
    return Stimulus.posed(
        t, rotation, field, rate_radps=body_rate(t, rotation), position_ned_m=position, current_a=current,
        throttle=throttle, temperature_degc=temperature, motors=motors,
    )  # fmt: skip


def stimulus_of(recipe: Recipe) -> Stimulus:
    """Make the inputs of a recording."""
    from mavcompass.earth_field import decimal_year, earth_field

    field = earth_field(*PLACE, round(decimal_year(UTC_S), 3)).vector_mgauss
    return _stimulus(recipe, field, np.random.default_rng([recipe.seed, 1]))


def affected(stimulus: Stimulus, settings: Sequence[Setting]) -> Reading:
    """Return what sensors without noise say under effects."""
    return Distortion(settings).apply(stimulus, ideal(stimulus), np.random.default_rng(0))


def noisy(reading: Reading, rng: np.random.Generator) -> Reading:
    """Add the sensors' noise, of first-order correlation."""
    from scipy.signal import lfilter

    def with_noise(group: Group) -> FloatArray:
        values, (sigma, rho) = group_values(reading, group), _NOISE[group]
        scatter = [sigma * math.sqrt(1.0 - rho**2)], [1.0, -rho]
        return np.asarray(values + lfilter(*scatter, rng.standard_normal(values.shape), axis=0))

    return Reading(*(with_noise(group) for group in GROUPS))


def to_track(stimulus: Stimulus, reading: Reading, name: str = "case") -> Track:
    """Write a recording down as a Track with the attitude as an independent reference."""
    t = stimulus.time_s
    r = stimulus.rotation
    roll = np.arctan2(r[:, 2, 1], r[:, 2, 2])
    pitch = np.arcsin(np.clip(-r[:, 2, 0], -1.0, 1.0))
    yaw = np.arctan2(r[:, 1, 0], r[:, 0, 0])
    return Track(
        source=name,
        compasses={1: MagSeries(1, Series.of(t, reading.mag_mgauss))},
        acc_mps2=Series.of(t, reading.acc_mps2),
        gyro_radps=Series.of(t, reading.gyro_radps),
        reference_q=Series.of(t, euler_to_quaternion(roll, pitch, yaw)),
        position_ned_m=Series.of(t, stimulus.position_ned_m),
        place=Series.of(t[:1], np.array([PLACE])),
        current_a=Series.of(t, stimulus.current_a),
        throttle=Series.of(t, stimulus.throttle),
        temperature_degc=Series.of(t, stimulus.temperature_degc),
        motors=Series.of(t, stimulus.motors),
        utc_offset_s=UTC_S,
    )


def make_track(recipe: Recipe, settings: Sequence[Setting] = (), noise_seed: int = 0) -> Track:
    """Make a recording with effects; the same recipe with another noise seed repeats the motion."""
    stimulus = stimulus_of(recipe)
    rng = np.random.default_rng([recipe.seed, noise_seed, 2])
    clean = [s for s in settings if s.effect.stage < Stage.SENSOR]
    late = [s for s in settings if s.effect.stage >= Stage.SENSOR]
    reading = Distortion(clean).apply(stimulus, ideal(stimulus), rng)
    reading = Distortion(late).apply(stimulus, noisy(reading, rng), rng)
    return to_track(stimulus, reading)


_SIZES = (6.0, 150.0)
_CLEAR = 0.9
_FOUND_BY_TRACE = frozenset({"quantisation", "stale_samples", "noise_excess", "timestamp_jitter"})
_NEVER_NAMED = frozenset({"bias_random_walk"})


def usable_effects(stimulus: Stimulus) -> list[Effect]:
    """List the effects that a motion can show at all."""
    varied = {name for name, values in stimulus.loads.items() if float(np.ptp(values)) > 3.0e-1}
    if float(np.ptp(stimulus.motors, axis=0).max()) > 0.05:
        varied.add("motors")
    if float(np.ptp(stimulus.position_ned_m, axis=0).max()) > 0.2:
        varied.add("position")
    down = stimulus.rotation[:, 2, :2]
    if math.sqrt(float(down.var(axis=0).sum())) > math.sin(math.radians(4.0)):
        varied.add("tilt")
    varied |= {"turning", "reference", "limit"}  # a limit is what its effect brings
    return [e for e in catalogue().values() if e.id not in _NEVER_NAMED and not e.lacking(varied)]


def draw_setting(effect: Effect, stimulus: Stimulus, rng: np.random.Generator) -> Setting:
    """Draw parameters of typical size and random direction."""
    theta = effect.default.copy()
    for i, p in enumerate(effect.parameters):
        if _is_amplitude(p):
            theta[i] = p.scale * rng.normal() * 2.0
        elif p.low >= 0.0 and not p.integer:
            theta[i] = p.default * math.exp(rng.uniform(-0.7, 0.7))
    span = float(stimulus.time_s[-1])
    if effect.id == "hard_iron_step":
        theta[3] = rng.uniform(0.15, 0.7) * span
        theta[4] = rng.uniform(theta[3] / span + 0.1, 0.95) * span
        if rng.random() < 0.5:
            theta[4] = effect.parameters[4].high
    elif effect.id == "orientation":
        theta[0] = float(rng.choice([2, 4, 6, 8, 10, 16, 18, 24, 25]))
    elif effect.id == "ac_interference":
        theta[6] = rng.uniform(0.5, 9.0)
    elif effect.id == "spatial_dipole":
        theta[:3] = rng.normal(0.0, 2.5, 3)
        theta[3:6] = rng.normal(0.0, 60.0, 3)
    elif effect.id == "clipping":
        theta[0] = rng.uniform(0.75, 0.95) * float(np.abs(ideal(stimulus).mag_mgauss).max())
    elif effect.id == "relay_field":
        theta[3], theta[4] = 0.0, float(np.quantile(stimulus.throttle, rng.uniform(0.3, 0.7)))
    return _inside(effect, theta)


def _is_amplitude(parameter: Parameter) -> bool:
    """Tell what may have either sign from moments, and from loads that it begins at."""
    name = parameter.name
    return parameter.low < 0.0 < parameter.high and name not in {*MOMENTS, "reference_degc", "threshold"}


def scaled(setting: Setting, factor: float) -> Setting:
    """Make an effect weaker or stronger by its amplitudes."""
    theta = setting.theta.copy()
    for i, p in enumerate(setting.effect.parameters):
        place = setting.effect.id == "spatial_dipole" and p.unit in ("m", "s")
        late = p.name in ("lag_s", "time_constant_s") or setting.effect.id == "eddy_current"
        if (_is_amplitude(p) and not place) or late:
            theta[i] *= factor
    return _inside(setting.effect, theta)


def _inside(effect: Effect, theta: FloatArray) -> Setting:
    """Keep amplitudes clear of the ends of their ranges, where no diagnosis may name them."""
    moved = np.array([p.scale > 0.0 and not p.optional for p in effect.parameters])
    clear = np.where(moved, _CLEAR, 1.0)
    low = np.where(effect.lower < 0.0, effect.lower * clear, effect.lower)
    return Setting(effect, np.clip(theta, low, effect.upper * clear))


def size_sigma(stimulus: Stimulus, settings: Sequence[Setting]) -> float:
    """Return the detectability d: the whitened length of the shift that effects make."""
    before, after = ideal(stimulus), affected(stimulus, settings)
    changes = {g: group_values(after, g) - group_values(before, g) for g in GROUPS}
    return math.sqrt(sum(float((CASE_NOISE[g].whiten(change) ** 2).sum()) for g, change in changes.items()))


def to_size(stimulus: Stimulus, setting: Setting, wanted: float) -> Setting:
    """Scale an effect until it has about the wanted detectability."""
    for _ in range(4):
        size = size_sigma(stimulus, [setting])
        if size <= 0.0:
            break
        setting = scaled(setting, wanted / size)
    return setting


def draw_label(seed: int, index: int, tier: Tier | None = None) -> Label:
    """Draw one case."""
    rng = np.random.default_rng([seed, index, 77])
    shares = SHARES["bench"]
    chosen: Tier = tier or rng.choice(list(shares), p=list(shares.values()))
    motion: Motion = MOTIONS[int(rng.integers(3))]
    recipe = Recipe(motion, seed=int(rng.integers(2**31)))
    stimulus = stimulus_of(recipe)
    count = {"none": 0, "pair": 2}.get(chosen, 1)
    usable = usable_effects(stimulus)
    if chosen != "single":
        usable = [e for e in usable if e.id not in _FOUND_BY_TRACE]
    picked = [usable[int(i)] for i in rng.choice(len(usable), count, replace=False)]
    settings = []
    for effect in picked:
        setting = draw_setting(effect, stimulus, rng)
        fixed = effect.kind != "mean" or effect.id == "clipping"
        wanted = math.exp(rng.uniform(*np.log(_SIZES)))
        settings.append(setting if fixed else to_size(stimulus, setting, wanted))
    size = size_sigma(stimulus, settings) if settings else 0.0
    return Label(chosen, motion, recipe.seed, tuple(spell(s) for s in settings), size)


def recipe_of(label: Label) -> Recipe:
    """Return the motion of a label."""
    return Recipe(cast(Motion, label.motion), seed=label.seed)


def tracks_of(label: Label) -> tuple[Track, Track]:
    """Make the recording of a label, and a baseline of the same kind of motion without effects."""
    stimulus = stimulus_of(recipe_of(label))
    settings = [parse(text) for text in label.effects]
    rng = np.random.default_rng([label.seed, 3])
    early = [s for s in settings if s.effect.stage is not Stage.SENSOR]
    late = [s for s in settings if s.effect.stage is Stage.SENSOR]
    reading = noisy(Distortion(early).apply(stimulus, ideal(stimulus), rng), rng)
    reading = Distortion(late).apply(stimulus, reading, rng)
    before = stimulus_of(replace(recipe_of(label), seed=label.seed ^ 0x5EED))
    baseline = noisy(ideal(before), np.random.default_rng([label.seed, 4]))
    return to_track(stimulus, reading), to_track(before, baseline, "baseline")


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


def case_of(generator: Generator, tier: Tier, seed: int) -> VehicleCase:
    """Make the case of others that a label is of: one whose cause is withheld is a single one."""
    if generator != "another":
        return make_case(seed, "single" if tier == "withheld" else tier)
    made = closed_form.make(seed, _COUNTS[tier])
    flight = made.flight
    return VehicleCase(
        track=_track(flight, "flight"),
        baseline=_track(made.baseline, "baseline"),
        effects=made.effects,
        clean_nominal_mgauss=flight.plain_mgauss,
        clean_mgauss=flight.raw_mgauss,
        words=f"another simulator {made.words}",
    )


def _track(simulated: closed_form.Simulated, name: str) -> Track:
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
        truth_q=Series.of(time_s, np.stack(closed_form.quaternion(simulated.angles_rad), axis=1)),
        utc_offset_s=closed_form.UTC_S,
        **found,  # type: ignore[arg-type]
    )


def shifts(names: Iterable[str]) -> bool:
    """Tell whether all of these effects move the readings, rather than scatter or repeat them."""
    every = catalogue()
    return all(name not in every or every[name].kind in ("mean", "discrete") for name in names)


def draw_case(generator: Generator, seed: int, index: int, tier: Tier | None) -> tuple[Label, Track, Track]:
    """Draw one case of a generator: its label, the recording and the baseline."""
    if generator == "bench":
        label = draw_label(seed, index, tier)
        return label, *tracks_of(label)
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
