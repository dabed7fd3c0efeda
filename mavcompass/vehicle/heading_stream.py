"""The live heading of a vehicle: rates asked for and restored, one heading per fresh message."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from mavcompass import messages as mav
from mavcompass.attitude import Level
from mavcompass.attitude.recorded import hear
from mavcompass.compass_parameters import is_calibrated
from mavcompass.earth_field import EarthField, earth_field_of
from mavcompass.errors import LinkLost, NoReply, Refused
from mavcompass.frames import wrap_two_pi
from mavcompass.heading.compute import TwoAxisCompass, grid_convergence_rad
from mavcompass.heading.doubt import prior_sigma_rad
from mavcompass.heading.live import Agreement, LiveCompass
from mavcompass.heading.true_north import TrueNorth
from mavcompass.messages.telemetry import field_mgauss, imu_time_s
from mavcompass.parameter_remarks import remarks_said
from mavcompass.procedure.commands import MessageRates
from mavcompass.procedure.script import Context, Machine, Script, expect
from mavcompass.procedure.vehicle_state import VehicleIdentity, find_vehicle
from mavcompass.track_builder import TrackBuilder
from mavcompass.two_clocks import shared_id
from mavcompass.vehicle.dialects import make_dialect
from mavcompass.vehicle.driver import SILENCE_S, run
from mavcompass.vehicle.link import Link

_KINDS: dict[int, type[mav.Message]] = {1: mav.RawImu, 2: mav.ScaledImu2, 3: mav.ScaledImu3}
_INSTANCES: dict[type[mav.Message], int] = {mav.ScaledImu: 1} | {kind: i for i, kind in _KINDS.items()}
# The compasses beside the one that is asked for need not be heard as often.
_BESIDE_HZ = 2.0
# What the receiver has shown of true north is looked at so often.
_LEARN_S = 60.0


@dataclass(frozen=True, slots=True)
class LiveHeading:
    """Hold one heading, radians; true and grid are None where the vehicle does not know its place.

    `sigma_rad` is of the true heading where there is one; `north` says what that rests on.
    """

    boot_s: float
    magnetic_rad: float
    sigma_rad: float
    true_rad: float | None = None
    grid_rad: float | None = None
    north: TrueNorth | None = None


@dataclass(frozen=True, slots=True)
class _Start:
    """Hold what the stream begins with."""

    identity: VehicleIdentity
    rates: MessageRates
    parameters: dict[str, float]
    world: EarthField | None
    convergence_rad: float


def headings(
    link: Link,
    source: str,
    instance: int = 1,
    *,
    two_axis: bool = False,
    rate_hz: float = 10.0,
    system: int | None = None,
    on_notes: Callable[[Iterable[str]], None] = lambda _: None,
) -> Iterator[LiveHeading]:
    """Yield the heading of one compass for as long as the vehicle speaks; close it to restore the rates.

    What the vehicle's other compasses show beside it may widen its sigma.
    `on_notes` is told, once, what to know of the parameters.
    Raises NoVehicle, UsageError where several are heard and `system` picks none, LinkLost, and Refused for a
    compass that the vehicle does not have, a two-axis heading where the place is unknown, or where two
    autopilots share a system id.
    """
    start = run(Machine(lambda context: _begin(context, source, instance, rate_hz, system)), link)
    try:
        on_notes(remarks_said(start.identity.autopilot, start.parameters, instance))
        flat = None
        if two_axis:
            if start.world is None:
                raise Refused(
                    "A two-axis heading needs the Earth's field, and the vehicle does not know its place.",
                    "Wait for its GPS, or use all three axes.",
                )
            flat = TwoAxisCompass(start.world.total_mgauss, start.world.inclination_rad)
        yield from _stream(link, source, start, instance, flat)
    finally:
        _restore(link, start)


def _begin(
    context: Context, source: str, instance: int, rate_hz: float, system: int | None
) -> Script[_Start]:
    identity = yield from find_vehicle(context, system)
    dialect = make_dialect(identity.autopilot, source)
    parameters = yield from dialect.compass_parameters(context)
    yield from dialect.nameplate(context, parameters)  # which two that share an id both answer
    builder = TrackBuilder(identity.autopilot, identity.kind)
    context.listeners.append(builder.add)
    rates = MessageRates()
    first = mav.ScaledImu if identity.autopilot == "px4" else mav.RawImu
    wanted: dict[type[mav.Message], float] = {first: rate_hz, mav.GlobalPositionInt: 2.0, mav.SystemTime: 1.0}
    wanted |= {mav.Attitude: rate_hz, mav.GpsRawInt: 5.0}
    beside = {i: min(rate_hz, _BESIDE_HZ) for i in dialect.instances(parameters)}
    wanted |= {_KINDS[i]: hz for i, hz in {**beside, instance: rate_hz}.items() if i > 1}
    yield from rates.ask(context, wanted)
    if instance not in dialect.instances(parameters):
        kind = first if instance == 1 else _KINDS[instance]
        if (yield from expect(context, kind, lambda imu: bool(field_mgauss(imu).any()), 2.0)) is None:
            yield from rates.restore(context)
            raise Refused(f"The vehicle has no compass {instance}.", "Choose with --compass.")
    place = yield from expect(context, mav.GlobalPositionInt, timeout_s=2.0)
    if place is not None:
        yield from expect(context, mav.SystemTime, timeout_s=1.5)
    world = earth_field_of(builder.build())
    convergence = grid_convergence_rad(place.lat * 1e-7, place.lon * 1e-7) if place is not None else math.nan
    return _Start(identity, rates, parameters, world, convergence)


def _stream(
    link: Link, source: str, start: _Start, instance: int, flat: TwoAxisCompass | None
) -> Iterator[LiveHeading]:
    compasses: dict[int, LiveCompass] = {}
    level, agreement = Level(start.identity.kind), Agreement()
    chosen: type[mav.Message] | None = None
    heard_s, learnt_s = link.now(), -math.inf
    while True:
        heard = link.receive(0.5)
        if start.identity.system in link.statistics.shared:
            raise Refused(*shared_id(start.identity.system))
        if heard is None or heard.system != start.identity.system:
            if link.now() - heard_s > SILENCE_S:
                raise LinkLost("The vehicle fell silent.", "Bring the link back and run again.")
            continue
        heard_s = heard.time_s
        message = heard.message
        hear(level, message)
        if isinstance(message, mav.GpsRawInt) and instance in compasses:
            compasses[instance].hear_receiver(message)
            if heard_s - learnt_s > _LEARN_S:
                compasses[instance].learn_north(start.identity.kind)
                learnt_s = heard_s
        of = _INSTANCES.get(type(message))
        if of is None or (of == 1 and chosen not in (None, type(message))):
            continue
        if of == 1:
            chosen = type(message)  # RAW_IMU and SCALED_IMU both carry compass 1: one of them is enough
        if of not in compasses:
            compasses[of] = _compass(source, start, of)
        boot_s = float(imu_time_s(message))
        found = compasses[of].update(heard.time_s, boot_s, _three(field_mgauss(message)), level)
        if found is None:
            continue
        agreement.hear(found, compasses, level.rate_radps)
        if of != instance:
            continue
        magnetic = found.magnetic_rad
        if flat is not None:
            x, y, _ = _three(field_mgauss(message))
            magnetic = flat.update(x, y, level.roll_rad, level.pitch_rad)
        yield _heading(boot_s, magnetic, found.sigma_rad, compasses[of].north, start.convergence_rad)


def _compass(source: str, start: _Start, instance: int) -> LiveCompass:
    compass, dialect = LiveCompass(instance), make_dialect(start.identity.autopilot, source)
    compass.set_world(start.world)
    in_force = dialect.correction(start.parameters, instance)
    compass.calibration_sigma_rad = prior_sigma_rad(
        is_calibrated(start.identity.autopilot, start.parameters, instance, in_force)
    )
    rotation = dialect.raw_rotation(start.parameters, instance)
    if rotation is not None:
        compass.set_uncorrected(in_force, rotation)
    return compass


def _heading(
    boot_s: float, magnetic: float, sigma: float, north: TrueNorth | None, convergence_rad: float
) -> LiveHeading:
    if north is None:
        return LiveHeading(boot_s, magnetic, sigma)
    true = float(wrap_two_pi(magnetic + north.turn_rad))
    grid = float(wrap_two_pi(true - convergence_rad))
    return LiveHeading(boot_s, magnetic, math.hypot(sigma, north.sigma_rad), true, grid, north)


def _three(vector: object) -> tuple[float, float, float]:
    x, y, z = vector.tolist()  # type: ignore[attr-defined]
    return (x, y, z)


def _restore(link: Link, start: _Start) -> None:
    def script(context: Context) -> Script[None]:
        context.system, context.component = start.identity.system, start.identity.component
        yield from start.rates.restore(context)

    try:
        run(Machine(script), link)
    except (LinkLost, NoReply):
        pass  # who is gone keeps nothing
