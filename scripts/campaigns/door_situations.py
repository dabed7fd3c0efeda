"""The situations of `doors.py`: simulated vehicles, what they say, what is right of them; and their wire."""

from __future__ import annotations

import copy
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mavcompass import messages as mav
from mavcompass.compass_parameters import mounting_values
from mavcompass.correction import FieldCorrection
from mavcompass.frames import FloatArray, euler_to_matrix
from mavcompass.logs import TlogWriter
from mavcompass.simulation.autopilot.board import Outgoing
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.link import LinkStatistics
from mavcompass.vehicle.links.simulated import SimulatedLink
from mavcompass.vehicle.wire import FrameWriter
from mavcompass.vehicle.wire.framing import split_frame

START_US = 1_767_225_600_000_000
OTHERS, PARAMETERS = "other compasses", "parameters"
UNSEEN = "Which way the compass is mounted cannot be seen"

Edit = Callable[[mav.Message, SimulatedAutopilot], mav.Message | None]


def as_it_is(message: mav.Message, vehicle: SimulatedAutopilot) -> mav.Message:
    """Say what the vehicle says."""
    return message


class Wire:
    """Be the vehicles at the far end of a wire: with frames, sequence numbers, and a recording of it."""

    def __init__(self, vehicles: Sequence[SimulatedAutopilot], edit: Edit, tlog: Path) -> None:
        self.vehicles, self._edit, self._tlog = vehicles, edit, TlogWriter(tlog)
        self.statistics = LinkStatistics()
        self._writers = [FrameWriter() for _ in vehicles]
        for k, writer in enumerate(self._writers):  # each has said something before
            for _ in range(90 * k):
                writer.write(mav.Heartbeat(), 1, 1)
        self._recording = True

    @property
    def time_s(self) -> float:
        """Return the virtual time."""
        return self.vehicles[0].time_s

    def receive(self, message: mav.Message, system: int, component: int, port: int = 0) -> None:
        """Hand a message to the vehicles; what comes after the first write is not recorded."""
        if isinstance(message, mav.ParamSet):
            self.close()
        for vehicle in self.vehicles:
            vehicle.receive(message, system, component, port)

    def advance(self, until_s: float) -> list[Outgoing]:
        """Let time pass, and note the frames."""
        said = [(k, out) for k, one in enumerate(self.vehicles) for out in one.advance(until_s)]
        heard = []
        for k, out in sorted(said, key=lambda item: item[1].time_s):
            message = self._edit(out.message, self.vehicles[k])
            if message is None:
                continue
            data = self._writers[k].write(message, out.system, out.component)
            self.statistics.count(out.system, out.component, split_frame(data).sequence, message)
            if self._recording and out.port in (None, 0):
                self._tlog.append(START_US + round(out.time_s * 1e6), data)
            heard.append(replace(out, message=message))
        return heard

    def close(self) -> None:
        """End the recording."""
        if self._recording:
            self._tlog.close()
        self._recording = False

    def link(self) -> SimulatedLink:
        """Plug in."""
        link = SimulatedLink(self)
        link.statistics = self.statistics
        return link


@dataclass(frozen=True)
class Situation:
    """Hold what is tried, and what is right.

    Attributes:
        family: its line in the table. make: makes the vehicle, armed or not.
        verdict, says: what is right, and words of the reason or remark for it.
        needs: the evidence without which that cannot be seen; what is right then is `blind`.
        edit: what becomes of its messages. vehicles: how many there are, one system id for all.
        mends: True where `--orientation` is to give an accepted result.
    """

    family: str
    make: Callable[[bool], SimulatedAutopilot]
    verdict: str
    says: str = ""
    needs: frozenset[str] = frozenset()
    blind: tuple[str, str] = ("accepted", "")
    edit: Edit = as_it_is
    vehicles: int = 1
    mends: bool = False


# --- vehicles -----------------------------------------------------------------------------------------


def vehicle(kind: str, seed: int, armed: bool, iron: str = "old", **given: Any) -> SimulatedAutopilot:
    """Make a vehicle whose first compass is wrong ("old"), right ("exact"), or was never calibrated."""
    like = SimulatedAutopilot(kind, seed=seed, calibration="exact" if iron == "exact" else "old")
    setups = like.board.compass_setups
    if iron == "never":
        setups = (replace(setups[0], in_force=FieldCorrection()), *setups[1:])
    made = SimulatedAutopilot(kind, seed=seed, armed=armed, compasses=setups, **given)
    if not armed:
        made.advance(10.0)
    return made


def setting_of(kind: str, rotation: FloatArray) -> dict[str, float]:
    """Spell the mounting by a rotation (3, 3) of a kind of vehicle's first compass."""
    autopilot = "px4" if kind.startswith("px4") else "ardupilot"
    return mounting_values(autopilot, SimulatedAutopilot(kind).firmware.parameters.store.values, 1, rotation)


def turned(kind: str, seed: int, rotation: FloatArray, armed: bool) -> SimulatedAutopilot:
    """Make a vehicle whose first compass is mounted by a rotation (3, 3) that its parameters do not tell."""
    right, known = setting_of(kind, rotation), SimulatedAutopilot(kind).firmware.parameters.store.values
    wrong = {name: known[name] for name in right if name != "CUST_ROT_ENABLE"}
    return vehicle(kind, seed, armed, parameters=right, storage=wrong)


def then(made: SimulatedAutopilot, **values: float) -> SimulatedAutopilot:
    """Set parameters of a vehicle that has started."""
    for name, value in values.items():
        assert made.firmware.parameters.store.set(name, value)
    return made


def loaded(made: SimulatedAutopilot, swing_a: float) -> SimulatedAutopilot:
    """Let something draw 14 A, more and less by a swing every 17 s."""
    around, board = made.board.surroundings, made.board

    def surroundings() -> Any:
        swing = swing_a * math.sin(2.0 * math.pi * board.now_us * 1e-6 / 17.0)
        return around()._replace(current_a=14.0 + swing)

    board.surroundings = surroundings  # type: ignore[method-assign]
    return made


def only(*instances: int) -> Edit:
    """Leave out the messages of other compasses."""
    kinds = {2: mav.ScaledImu2, 3: mav.ScaledImu3}
    gone = tuple(kind for i, kind in kinds.items() if i not in instances)
    return lambda message, _: None if isinstance(message, gone) else message


def placeless(message: mav.Message, _: SimulatedAutopilot) -> mav.Message | None:
    """Have no receiver."""
    return None if isinstance(message, mav.GlobalPositionInt | mav.GpsRawInt) else message


def two_antennas(message: mav.Message, of: SimulatedAutopilot) -> mav.Message:
    """Have a receiver with a second antenna."""
    if not isinstance(message, mav.GpsRawInt):
        return message
    return replace(message, yaw=round(math.degrees(of.body.yaw_rad) % 360.0 * 100.0) or 36000)


# --- situations ---------------------------------------------------------------------------------------


def situations(free: int) -> Iterator[Situation]:
    """Yield all of them; `free` is how many free mountings there are of each autopilot."""
    both = frozenset({OTHERS})
    for kind in ("rover", "px4-copter"):
        px4 = kind == "px4-copter"

        def made(iron: str, kind: str = kind, **given: Any) -> Callable[[bool], SimulatedAutopilot]:
            return lambda armed: vehicle(kind, 3, armed, iron, **copy.deepcopy(given))

        def named(name: str, kind: str = kind) -> str:
            return f"{name}, {kind}"

        for seed, (name, rotation) in enumerate(mountings(free)):
            setting, known = setting_of(kind, rotation), SimulatedAutopilot(kind).firmware.parameters.store
            if all(known[parameter] == value for parameter, value in setting.items()):
                continue
            yield Situation(
                named(name),
                lambda armed, r=rotation, k=kind, n=seed: turned(k, n % 5, r, armed),
                "refused",
                said_of(setting),
                both | {PARAMETERS} if not px4 else frozenset({PARAMETERS}),
                ("accepted or refused", UNSEEN) if not px4 else ("refused", ""),
                two_antennas if px4 else as_it_is,
                mends=True,
            )
        yield Situation(
            named("two contradict"),
            lambda armed, k=kind: then(
                turned(k, 3, euler_to_matrix(0.0, 0.0, math.pi / 2.0), armed),
                **({} if k.startswith("px4") else {"COMPASS_DEV_ID3": 0.0}),
            ),
            "refused",
            "one of them is mounted turned, or set so, and nothing tells which",
            both,
            ("accepted", UNSEEN),
            only(1, 2),
        )
        one = {"CAL_MAG1_ID": 0.0} if px4 else {"COMPASS_DEV_ID2": 0.0, "COMPASS_DEV_ID3": 0.0}
        yield Situation(named("one alone"), made("old", storage=one), "accepted", UNSEEN, edit=only(1))
        for swing, word in ((10.0, "varies"), (0.3, "hardly varies")):
            yield Situation(
                named(f"load {word}"),
                lambda armed, k=kind, s=swing: loaded(
                    vehicle(k, 3, armed, effects=["motor_current:x=2.0,y=-1.2"]), s
                ),
                # Still positions alone do not part motors from iron: what they cannot tell they refuse.
                "accepted or refused" if word == "varies" else "accepted",
                needs=frozenset({PARAMETERS}),
            )
        yield Situation(named("no place"), made("old"), "accepted", "place is unknown", edit=placeless)
        yield Situation(named("gyro bias"), made("old", effects=["gyro_bias"]), "accepted")
        yield Situation(named("accelerometer bias"), made("old", effects=["accel_bias"]), "accepted")
        yield Situation(
            named("exactly right"), made("exact"), "right", "", frozenset({PARAMETERS}), ("accepted", "")
        )
        yield Situation(named("never calibrated"), made("never"), "accepted")
    rover = lambda **values: lambda armed: then(vehicle("rover", 3, armed), **values)  # noqa: E731
    known = SimulatedAutopilot("rover").firmware.parameters.store.values
    asks = frozenset({PARAMETERS})
    yield Situation(
        "priority will change",
        rover(COMPASS_PRIO1_ID=known["COMPASS_DEV_ID2"]),
        "accepted",
        "after the next start the compasses change places",
        asks,
    )
    yield Situation(
        "duplicate device id",
        rover(COMPASS_DEV_ID2=known["COMPASS_DEV_ID"]),
        "accepted",
        "have the same device id",
        asks,
    )
    yield Situation(
        "GPS yaw steers",
        rover(EK3_SRC1_YAW=2.0),
        "accepted",
        "takes its yaw from the satellite receivers",
        asks,
        edit=two_antennas,
    )
    yield Situation(
        "two autopilots on an id", rover(), "error", "Two autopilots share system id 1", vehicles=2
    )


def said_of(setting: Mapping[str, float]) -> str:
    """Return the words for a mounting: of a numbered one its number, too."""
    name, value = list(setting.items())[-1]
    numbered = value < 100.0 and name.endswith(("ORIENT", "ROT"))
    return f"{name} {value:g} is right" if numbered else "is mounted turned by"


def mountings(free: int) -> Iterator[tuple[str, FloatArray]]:
    """Yield the right angles, and as many free ones that are off by more than a board set by eye is."""
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0.0:
                yield "mounted at right angles", matrix
    rng = np.random.default_rng(2026)
    while free > 0:
        angles = rng.uniform(-math.pi, math.pi, 3)
        matrix = euler_to_matrix(angles[0], 0.5 * angles[1], angles[2])
        if math.acos(min(0.5 * (float(np.trace(matrix)) - 1.0), 1.0)) > math.radians(30.0):
            free -= 1
            yield "mounted at free angles", matrix
