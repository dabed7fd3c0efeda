"""What is installed on companion computers: unit, router snippet, configuration, BlueOS image."""

from __future__ import annotations

import configparser
import json
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from running_service import RunningService

from mavcompass import __version__
from mavcompass.installation.parts import params_path
from mavcompass.service.config import ServiceConfig, load_config
from mavcompass.service.run import STUCK_S
from mavcompass.vehicle.transport import UdpIn, parse_address

PROJECT = Path(__file__).parents[2]
DEPLOY = PROJECT / "scripts" / "deploy"


def parsed(path: Path) -> configparser.ConfigParser:
    parser = configparser.ConfigParser(strict=False, interpolation=None)
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    parser.read_string(path.read_text())
    return parser


def test_the_example_configuration_is_the_defaults() -> None:
    config = load_config(params_path("service.toml"))
    assert config == ServiceConfig()


def test_the_example_configuration_names_every_key() -> None:
    text = params_path("service.toml").read_text()
    for table in ServiceConfig.__slots__:
        for name in getattr(ServiceConfig(), table).__slots__:
            assert re.search(rf"^{name} = ", text, re.MULTILINE), f"{table}.{name}"


def test_the_unit_notifies_watches_and_has_time_to_stop() -> None:
    unit = parsed(DEPLOY / "mavcompass.service")
    service = unit["Service"]
    assert service["Type"] == "notify"
    assert service["KillSignal"] == "SIGTERM"
    assert float(service["WatchdogSec"]) > STUCK_S + 5.0
    assert float(service["TimeoutStopSec"]) >= 20.0
    command = shlex.split(service["ExecStart"])
    assert command[0].startswith("/") and command[1:3] == ["serve", "--config"]
    assert "AF_UNIX" in service["RestrictAddressFamilies"], "notifications are sent over one"
    assert unit["Install"]["WantedBy"] == "multi-user.target"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze")
def test_the_unit_gives_up_what_it_does_not_need() -> None:
    unit = str(DEPLOY / "mavcompass.service")
    options = ["--offline=true", "--no-pager", "--threshold=20"]  # tenths
    asked = subprocess.run(["systemd-analyze", "security", *options, unit], capture_output=True, text=True)
    if "offline" in asked.stderr:
        pytest.skip("this systemd-analyze cannot judge a file")
    assert asked.returncode == 0, asked.stdout[-500:]


def test_the_router_sends_to_where_the_service_listens() -> None:
    endpoint = parsed(DEPLOY / "mavlink-router.conf")["UdpEndpoint mavcompass"]
    assert endpoint["Mode"] == "Normal"
    listening = parse_address(ServiceConfig().vehicle.source)
    assert listening == UdpIn(endpoint["Address"], int(endpoint["Port"]))


def dockerfile() -> list[tuple[str, str]]:
    """The image file as instructions and their arguments, continued lines joined."""
    text = re.sub(r"\\\n\s*", " ", (DEPLOY / "blueos" / "Dockerfile").read_text())
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return [(line.split(maxsplit=1)[0], line.split(maxsplit=1)[1]) for line in lines]


def labels() -> dict[str, str]:
    found = {}
    for name, argument in dockerfile():
        if name == "LABEL":
            key, _, value = argument.partition("=")
            found[key] = shlex.split(value)[0]
    return found


def test_the_blueos_image_copies_only_what_is_there_and_starts_the_service() -> None:
    instructions = dockerfile()
    known = {"FROM", "WORKDIR", "COPY", "RUN", "ENV", "EXPOSE", "HEALTHCHECK", "LABEL", "ENTRYPOINT"}
    assert {name for name, _ in instructions} <= known
    for name, argument in instructions:
        if name == "COPY" and not argument.startswith("--from"):
            for source in argument.split()[:-1]:
                assert (PROJECT / source).exists(), source
    entry = json.loads(next(argument for name, argument in instructions if name == "ENTRYPOINT"))
    assert entry[1] == "serve"
    ports = {argument for name, argument in instructions if name == "EXPOSE"}
    config = load_config(DEPLOY / "blueos" / "mavcompass.toml")
    assert ports == {config.http.listen.rpartition(":")[2]}


def test_the_labels_are_those_that_blueos_reads() -> None:
    found = labels()
    assert found["version"] == __version__
    assert found["type"] in {"device-integration", "example", "theme", "tool", "other"}
    permissions, *_ = (json.loads(found[n]) for n in ("permissions", "authors", "company", "tags", "links"))
    assert permissions["HostConfig"]["NetworkMode"] == "host"
    assert all(bind.startswith("/usr/blueos/") for bind in permissions["HostConfig"]["Binds"])
    assert all({"name", "email"} <= set(author) for author in json.loads(found["authors"]))
    assert "core >=" in found["requirements"]


def test_blueos_is_told_what_is_served(quiet: RunningService) -> None:
    registration = quiet.stranger.get("/register_service").json()
    assert "route" not in registration, "nobody who is not told to is handed the token"
    assert registration["version"] == __version__
    assert quiet.stranger.get(registration["api"]).status_code == 200
    assert {"name", "description", "icon", "company", "webpage"} <= set(registration)
