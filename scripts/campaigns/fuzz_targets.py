"""What `fuzz.py` feeds: each takes bytes and raises only what is not the product's own error."""

from __future__ import annotations

import asyncio
import hashlib
import json
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from campaign import IN_MEMORY, PROJECT, borrow

from mavcompass.errors import MavCompassError
from mavcompass.gap.rehearsal import read_stored
from mavcompass.gap.result import SCHEMA as DIAGNOSIS_SCHEMA
from mavcompass.messages import Heartbeat, Incoming, ParamValue, RawImu, Statustext, message_id
from mavcompass.procedure.modes import ModeKeeper
from mavcompass.procedure.motion.safety import MotionGuard
from mavcompass.procedure.positions import Rest
from mavcompass.procedure.turning import GyroAngle
from mavcompass.procedure.vehicle_state import VehicleState, identify
from mavcompass.service.config import parse_config
from mavcompass.service.web.bodies import (
    Answer,
    BadRequest,
    Comparing,
    HistoryQuery,
    parse_address,
    parse_body,
)
from mavcompass.service.web.security import Guard
from mavcompass.service.work.tasks import CalibrationRequest
from mavcompass.simulation.effects import registry
from mavcompass.simulation.effects.registry import PRESET_SCHEMA, read_preset
from mavcompass.track_builder import TrackBuilder
from mavcompass.vehicle.link import LinkStatistics
from mavcompass.vehicle.parameters.files import read_parameter_file
from mavcompass.vehicle.parameters.undo import load_record
from mavcompass.vehicle.parameters.values import decode as decode_parameter
from mavcompass.vehicle.transport import parse_address as parse_source
from mavcompass.vehicle.wire import FrameParser, decode, encode

borrow("logs")
from mutations import originals, read_or_refuse  # noqa: E402

Target = Callable[[bytes], object]
_FOLDER = Path(tempfile.mkdtemp(prefix="fuzz", dir=IN_MEMORY))
# Frames of these are read by the listeners of a procedure.
_ARMED = Heartbeat(type=2, autopilot=3, base_mode=128, system_status=4)
_HEARD = (0, 1, 2, 22, 24, 26, 27, 29, 30, 32, 33, 36, 65, 74, 77, 105, 116, 129, 147, 193, 245, 253)


def framing(data: bytes) -> None:
    """Feed a port's bytes in pieces."""
    parser = FrameParser(LinkStatistics())
    step = 1 + data[0] % 61 if data else 1
    for at in range(0, len(data), step):
        for frame in parser.feed(data[at : at + step]):
            decode(frame.message_id, frame.payload)


def codec(data: bytes) -> None:
    """Decode a payload, and encode what came of it."""
    if len(data) > 3 and (message := decode(int.from_bytes(data[:3], "little"), data[3:])) is not None:
        encode(message)


def listeners(data: bytes) -> None:
    """Let everything that listens in a procedure hear messages with any numbers in them."""
    state, gyro, rest = VehicleState(), GyroAngle(), Rest()
    builder = TrackBuilder("ardupilot", "rover")
    guard = MotionGuard(state, gyro, "copter", ModeKeeper(state, "ardupilot"))
    for at in range(0, len(data) - 60, 60):
        message = decode(_HEARD[data[at] % len(_HEARD)], data[at + 1 : at + 60])
        if message is None:
            continue
        heard = Incoming(at * 0.01, 1, 1, message)
        identify(heard)
        if isinstance(message, ParamValue):
            decode_parameter(message, "bytewise" if data[at] & 1 else "cast")
        for listener in (state.hear, gyro.hear, rest.hear, guard.hear, builder.add):
            listener(heard)
        state.hear(Incoming(at * 0.01, 1, 1, _ARMED))  # a guard looks no further at one that is not
        guard.check(at * 0.01)
    with suppress(MavCompassError):
        builder.build()


def _file(suffix: str, read: Callable[[Path], object]) -> Target:
    path = _FOLDER / f"fuzzed{suffix}"

    def target(data: bytes) -> None:
        path.write_bytes(data)
        with suppress(MavCompassError):
            read(path)

    return target


def _text(read: Callable[[str], object]) -> Target:
    def target(data: bytes) -> None:
        with suppress(MavCompassError):
            read(data.decode("utf-8", "replace"))

    return target


def body(data: bytes) -> None:
    """Read a request's body and its address as each model."""
    for model in (CalibrationRequest, Comparing, Answer):
        with suppress(BadRequest):
            parse_body(data, "application/json", model)  # type: ignore[type-var]
    text = data.decode("utf-8", "replace")
    pairs = dict(pair.partition("=")[::2] for pair in text.split("&"))
    with suppress(BadRequest):
        parse_address(pairs, HistoryQuery)


def guard(data: bytes) -> None:
    """Let the service's guard judge a request with these headers."""
    names = (b"host", b"origin", b"authorization", b"content-length", b"sec-fetch-site")
    values = data.split(b"\n")
    headers = [*zip(names, values, strict=False)]
    scope: dict[str, Any] = {"type": "http", "method": "POST", "path": "/", "headers": headers}
    if data[:1] > b"\x80":
        scope["type"] = "websocket"

    async def inside(scope: Any, receive: Any, send: Any) -> None:
        given = dict(scope["headers"]).get(b"authorization", b"")
        assert scope["type"] == "websocket" or b"the right token" in given, "let in without the token"

    async def receive() -> dict[str, Any]:
        return {"type": "http.request"}

    async def send(message: Any) -> None: ...

    asyncio.run(Guard(inside, "the right token")(scope, receive, send))


def effect(data: bytes) -> None:
    """Read effects as `simulate` and SOURCE take them."""
    text = data.decode("utf-8", "replace")
    with suppress(MavCompassError):
        parse_source(f"sim:rover,effect={text}")
    with suppress(MavCompassError):
        registry.parse(text)


TARGETS: dict[str, Target] = {
    "framing": framing,
    "codec": codec,
    "listeners": listeners,
    "tlog": _file(".tlog", read_or_refuse),
    "dataflash": _file(".bin", read_or_refuse),
    "dataflash-text": _file(".log", read_or_refuse),
    "ulog": _file(".ulg", read_or_refuse),
    "csv": _file(".csv", read_or_refuse),
    "param": _file(".param", read_parameter_file),
    "params": _file(".params", read_parameter_file),
    "undo": _file(".json", load_record),
    "diagnosis": _file(".gap.json", read_stored),
    "preset": _file(".preset.json", read_preset),
    "toml": _text(parse_config),
    "address": _text(parse_source),
    "effect": effect,
    "body": body,
    "guard": guard,
}


def _diagnosis() -> bytes:
    recording = _FOLDER / "diagnosed.csv"
    recording.touch()
    cause = {"effect": "hard_iron", "parameters": {"x": 90.0}, "ci95": {"x": [80.0, 100.0]}}
    cause |= {"probability": 0.99, "ambiguous_with": []}
    belief = {"weight": 1.0, "effects": ["hard_iron"], "places": [["hard_iron", "x"]]}
    belief |= {"mean": [90.0], "covariance": [4.0]}
    diagnosis = {"schema": DIAGNOSIS_SCHEMA, "compass": 1, "verdict": "explained"}
    diagnosis |= {"log": {"path": str(recording), "sha256": hashlib.sha256(b"").hexdigest()}}
    return json.dumps(diagnosis | {"causes": [cause], "beliefs": [belief]}).encode()


def seeds(target: str) -> list[bytes]:
    """Return what a target's fuzzing begins with."""
    recordings = {
        "tlog": ".tlog",
        "dataflash": ".bin",
        "dataflash-text": ".log",
        "ulog": ".ulg",
        "csv": ".csv",
    }
    if target in recordings or target == "framing":
        contents = originals(_FOLDER / "originals")
        return [contents[recordings.get(target, ".tlog")][:6000]]
    if target == "diagnosis":
        return [_diagnosis()]
    preset = {"schema": PRESET_SCHEMA, "effects": ["hard_iron:x=100,y=-50", "motor_current:x=1"]}
    undo = b'{"schema":"mavcompass.undo/1","made_at":"","autopilot":"px4","source":"sim:rover",'
    texts: dict[str, list[bytes]] = {
        "param": [b"# saved\nCOMPASS_OFS_X,5\nCOMPASS_OFS_Y 1e-3\n"],
        "params": [b"# Vehicle-Id\tComponent\n1\t1\tCAL_MAG0_ID\t396809\t6\n1\t1\tCAL_MAG0_XOFF\t0.1\t9\n"],
        "undo": [undo + b'"before":{"A":1},"planned":{"A":2.5},"parameters":{}}'],
        "preset": [json.dumps(preset).encode()],
        "toml": [(PROJECT / "params" / "service.toml").read_bytes()[:3000]],
        "address": [
            b"udpin:0.0.0.0:14550",
            b"tcp:[::1]:5760",
            b"/dev/ttyACM0:57600",
            b"mavsdk+udpin://0.0.0.0:14540",
            b"serial:///dev/ttyACM0:57600",
            b"sim:rover,seed=3,effect=hard_iron+relay_field",
        ],
        "effect": [b"hard_iron:x=100,y=-50", b"motor_current:x=1e3"],
        "body": [b'{"compasses":[1],"motion":"hand","positions":4,"dwell_s":2.5}', b"kind=check&limit=3"],
        "guard": [b"localhost:8808\nhttp://localhost:8808\nBearer x\n12\nsame-origin", b"[::1]:1\n\n\n\n"],
    }
    if target in ("codec", "listeners"):
        messages = (RawImu(xmag=200), Statustext(2, "PreArm: compass"), ParamValue("COMPASS_OFS_X", 5.0, 9))
        if target == "codec":
            return [message_id(type(m)).to_bytes(3, "little") + encode(m)[1] for m in messages]
        return [b"".join(bytes([k]) + bytes(range(59)) for k in range(22))]
    return texts[target]
