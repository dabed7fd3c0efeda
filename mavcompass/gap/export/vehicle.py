"""The vehicle as a simulator must have it, and what an export is: a text, and what is lacking."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mavcompass.chance import chi_square_of
from mavcompass.correction import IDENTITY
from mavcompass.frames import FloatArray
from mavcompass.gap.replay.nuisance import known_iron
from mavcompass.gap.result import FIELD, MOTOR, Cause, Diagnosis, Iron, PosteriorComponent
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects import Setting, get
from mavcompass.simulation.effects.effect import Distortion, Signals
from mavcompass.simulation.physics.signals import Stimulus, ideal
from mavcompass.track import Track

# What such effects do, a baseline does not teach.
_OF_PLACES = frozenset({"position", "height"})


def settings_of(causes: Iterable[Cause]) -> list[Setting]:
    """Turn named causes into settings of their effects; parameters that were not fitted are neutral."""
    out = []
    for cause in causes:
        effect = get(cause.effect)
        theta = effect.neutral()
        for i, parameter in enumerate(effect.parameters):
            theta[i] = cause.parameters.get(parameter.name, theta[i])
        out.append(Setting(effect, np.clip(theta, effect.lower, effect.upper)))
    return out


def vehicle_settings(diagnosis: Diagnosis, beside_simulator: bool = False) -> list[Setting]:
    """Return what makes a simulator of the whole vehicle: the iron that its calibration cures, the causes.

    Where the baseline was the simulator itself, what it showed beside its calibration is an error of the
    attitude or of the world field, not iron: the simulator has none, and gets none of it.
    """
    causes = settings_of(diagnosis.causes)
    iron = diagnosis.in_force
    if iron is None:
        return causes
    own = 1.0 if beside_simulator else 0.0
    cured, tuned, taught = iron.cures, iron.tuned, iron.taught
    matrix = tuned.matrix - own * cured.matrix @ taught.matrix
    offset = tuned.offset_mgauss - own * taught.offset_mgauss
    motor = np.zeros(3)
    if iron.motor_source == "current":
        added = tuned.motor_mgauss - own * taught.motor_mgauss - cured.motor_mgauss
        motor = cured.motor_mgauss + (added if _is_known(added, diagnosis.beliefs) else 0.0)
    return _summed([*_iron(Iron(matrix, offset, motor)), *causes])


def _is_known(motor_mgauss: FloatArray, beliefs: Sequence[PosteriorComponent]) -> bool:
    """Tell whether a field of the motors beside the calibration's differs from zero, by the likeliest belief.

    A vehicle that draws hardly any current shows the noise of its compass there.
    """
    if not beliefs:
        return True
    covariance = max(beliefs, key=lambda belief: belief.weight).covariance[MOTOR, MOTOR]
    return float(motor_mgauss @ np.linalg.pinv(covariance) @ motor_mgauss) > chi_square_of(0.05, 3)


def follows_places(diagnosis: Diagnosis) -> bool:
    """Tell whether a named effect goes with the place or the height."""
    return any(_OF_PLACES & get(effect).needs for effect in diagnosis.effects)


def left_of_the_place(diagnosis: Diagnosis) -> float:
    """Return what a simulator leaves of a gap because its field is the world model's, mG^2.

    A field that goes with places and that of the place itself are told apart as far as the vehicle moved;
    the simulator gets the former alone.
    """
    if not diagnosis.beliefs or not follows_places(diagnosis):
        return 0.0
    local_mgauss = max(diagnosis.beliefs, key=lambda belief: belief.weight).mean[FIELD]
    closing = diagnosis.field
    return max(
        closing.after**2 + float(np.mean(local_mgauss**2)) - max(closing.after, closing.floor) ** 2, 0.0
    )


def nominal_settings(track: Track) -> list[Setting]:
    """Return the iron that the calibration of compass 1 cures: the vehicle as far as it is known."""
    correction = (track.compasses[1].calibration or IDENTITY).without_outputs()
    iron = known_iron(correction, np.zeros(0), correction.motor_source)
    return _iron(iron if iron.source == "current" else replace(iron, motor_mgauss=np.zeros(3)))


def _iron(iron: Iron) -> list[Setting]:
    """Split raw = A field + b + motor current into effects; A = R S, a turn and a symmetric part."""
    u, sizes, vt = np.linalg.svd(iron.matrix)
    turn, stretch = u @ vt, vt.T @ np.diag(sizes) @ vt
    vector = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
    offset = turn.T @ iron.offset_mgauss
    found: dict[str, dict[str, float]] = {}
    if np.abs(offset).max() > 0.0:
        found["hard_iron"] = dict(zip("xyz", offset.tolist(), strict=True))
    soft = stretch - np.eye(3)
    if np.abs(soft).max() > 1e-6:
        places = {"xx": (0, 0), "yy": (1, 1), "zz": (2, 2), "xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
        found["soft_iron"] = {name: float(soft[i, j]) for name, (i, j) in places.items()}
    if float(np.linalg.norm(vector)) > usual.export.turn_rad:
        found["misalignment"] = dict(zip("xyz", vector.tolist(), strict=True))
    if np.abs(iron.motor_mgauss).max() > 0.0:
        found["motor_current"] = dict(zip("xyz", iron.motor_mgauss.tolist(), strict=True))
    return settings_of(Cause(effect, values, {}, 1.0, ()) for effect, values in found.items())


def _summed(settings: list[Setting]) -> list[Setting]:
    """Make one of what the calibration cures of the motors' field and what was found beside it."""
    motors = [setting for setting in settings if setting.effect.id == "motor_current"]
    if len(motors) < 2:
        return settings
    cured, found = motors
    whole = Setting(cured.effect, cured.theta + found.theta)
    return [whole if setting is cured else setting for setting in settings if setting is not found]


def affine_map(settings: Sequence[Setting]) -> tuple[FloatArray, FloatArray]:
    """Compose affine effects to raw = A field + b: A (3, 3), b (3,), by passing a basis through them."""
    field: FloatArray = np.zeros((4, 3))
    field[1:] = 100.0 * np.eye(3)
    stimulus = Stimulus.posed(np.arange(4.0), np.tile(np.eye(3), (4, 1, 1)), field)
    out = Distortion(list(settings)).run(Signals(stimulus, ideal(stimulus)), None)
    raw = out.reading.mag_mgauss
    return (raw[1:] - raw[0]).T / 100.0, raw[0]


@dataclass(frozen=True, slots=True)
class Found:
    """Hold what is to be exported.

    Attributes:
        settings: the whole vehicle's, in the order in which they act.
        source: where they were found.
        heading_deg: what each named effect costs in heading, rms.
        shrink: by how much the gap in the field closes with all of them.
        shares: the part of that which each named effect has.
        known: in sentences, how well the parameters of each are known.
        place_mgauss: what they leave because the field of the place is not the world model's, rms.
    """

    settings: Sequence[Setting]
    source: str = ""
    heading_deg: Mapping[str, float] = field(default_factory=dict)
    shrink: float = 0.0
    shares: Mapping[str, float] = field(default_factory=dict)
    known: tuple[str, ...] = ()
    place_mgauss: float = 0.0

    def headed(self, simulator: str) -> list[str]:
        """Return the first sentences of a file: where this comes from, and how well it is known."""
        return [f"What was found in {self.source or 'a recording'}, for {simulator}", *self.known]

    def without(self, setting: Setting, simulator: str) -> str:
        """Say that a simulator has no such thing, and what error of the heading stays for it."""
        cost = self.heading_deg.get(setting.effect.id)
        stays = "" if cost is None else f" {cost:.1f} deg of heading stay unsimulated."
        return f"{setting.effect.id}: {setting.effect.title}. {simulator} has no such thing.{stays}"

    def lost(self, simulator: str, held: Callable[[Setting], object]) -> tuple[list[str], list[str]]:
        """Return what a simulator lacks beside the affine effects, in sentences, and those effects.

        `held` tells what of a setting it holds, if anything.
        """
        gone = [s for s in self.settings if not s.effect.affine and not held(s)]
        return [self.without(s, simulator) for s in gone], [s.effect.id for s in gone]

    def of_the_place(self, simulator: str) -> list[str]:
        """Say by how much the field of the place differs from the one that a simulator has."""
        if self.place_mgauss < usual.export.place_mgauss:
            return []
        return [f"The field of the place, {self.place_mgauss:.1f} mG. {simulator} has the world model's."]

    def offset_alone(self, simulator: str, held: Collection[str]) -> tuple[FloatArray, list[str], list[str]]:
        """Return the offset (3,) in mG for a simulator that has no matrix, what it lacks, and those effects.

        Beside the offset it has the effects that it holds.
        """
        lost, gone = self.lost(simulator, lambda setting: setting.effect.id in held)
        matrix, offset = affine_map([s for s in self.settings if s.effect.affine])
        if np.abs(matrix - np.eye(3)).max() <= usual.export.matrix:
            return offset, lost, gone
        bent = [s.effect.id for s in self.settings if s.effect.affine and s.effect.id != "hard_iron"]
        return (
            offset,
            [f"Gains, oblique axes and turns of the compass: {simulator} has none.", *lost],
            bent + gone,
        )

    def promised(self, exported: Exported) -> float:
        """Return by how much the gap closes with those effects alone that an export holds."""
        return max(self.shrink - sum(self.shares.get(effect, 0.0) for effect in set(exported.left_out)), 0.0)


def found_in(diagnosis: Diagnosis, source: str, beside_simulator: bool = False) -> Found:
    """Collect the whole vehicle of a diagnosis, what each of its causes costs in heading, and its share.

    `beside_simulator` says that the baseline was the simulator that is to have it.
    """
    costs = {cause.effect: cause.removes_deg for cause in diagnosis.causes}
    gap = diagnosis.field.nominal**2 - diagnosis.field.floor**2
    # What scatters has no bar in the waterfall: it removes its own variance.
    parts = {cause.effect: cause.removes_mgauss**2 for cause in diagnosis.causes}
    parts |= {bar.effect: bar.part_mgauss2 for bar in diagnosis.waterfall}
    shares = {effect: part / gap for effect, part in parts.items()} if gap > 0.0 else {}
    settings = vehicle_settings(diagnosis, beside_simulator)
    known = tuple(known_to(cause) for cause in diagnosis.causes if cause.ci95)
    left2 = left_of_the_place(diagnosis)
    shrink = diagnosis.field.shrink - (left2 / gap if gap > 0.0 else 0.0)
    return Found(settings, source, costs, shrink, shares, known, math.sqrt(left2))


@dataclass(frozen=True, slots=True)
class Exported:
    """Hold a file for a simulator.

    Attributes:
        text: of the file. use: how a person uses it, FILE in the place of its name.
        parameters: the simulator's own, where it has some.
        lacking: in sentences what it cannot hold; left_out: the effects among that.
    """

    text: str
    use: str
    parameters: Mapping[str, float] = field(default_factory=dict)
    lacking: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()


def known_to(cause: Cause) -> str:
    """Say how well the parameters of a cause are known: a vehicle that never tilts hardly tells z."""
    units = {p.name: "" if p.unit == "1" else f" {p.unit}" for p in get(cause.effect).parameters}
    parts = [f"{name} {low:.3g} to {high:.3g}{units[name]}" for name, (low, high) in cause.ci95.items()]
    return f"{cause.effect}, 95 %: {', '.join(parts)}"


def commented(mark: str, lines: Iterable[str]) -> list[str]:
    """Write sentences as comments."""
    return [f"{mark} {line}" for line in lines]
