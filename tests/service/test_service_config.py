"""What a person sees who writes the service's configuration."""

from __future__ import annotations

from pathlib import Path

import pytest

from mavcompass.errors import UsageError
from mavcompass.service.config import ServiceConfig, load_config, parse_config, split_host_port


def mistakes(text: str) -> str:
    with pytest.raises(UsageError) as caught:
        parse_config(text, "boat.toml")
    return caught.value.what


def test_an_empty_configuration_means_the_defaults() -> None:
    assert parse_config("") == ServiceConfig()


def test_every_table_is_read() -> None:
    config = parse_config(
        """
        [vehicle]
        source = "tcp:127.0.0.1:5760"
        compasses = [1, 3]
        rate_hz = 100
        [http]
        listen = "0.0.0.0:9000"
        allowed_origins = ["http://boat.local:9000"]
        [mavlink]
        accept_commands = false
        [heading]
        publish = "udp:127.0.0.1:8809"
        [watch]
        dip_deg = 2.5
        [storage]
        folder = "/tmp/somewhere"
        """
    )
    assert config.vehicle.source == "tcp:127.0.0.1:5760"
    assert config.vehicle.compasses == (1, 3)
    assert config.vehicle.rate_hz == 100
    assert config.http.allowed_origins == ("http://boat.local:9000",)
    assert not config.mavlink.accept_commands
    assert config.heading.publish == "udp:127.0.0.1:8809"
    assert config.watch.dip_deg == 2.5
    assert config.folder == Path("/tmp/somewhere")
    assert config.token_file == Path("/tmp/somewhere/token")
    assert config.is_open_to_the_network


def test_all_mistakes_are_told_at_once_each_with_its_line() -> None:
    text = '[vehicle]\nsource = "nowhere"\n\n# a remark\n[watch]\nage_days = "old"\ndip_degree = 3\n'
    told = mistakes(text)
    assert "3 mistakes" in told
    assert "boat.toml:2: vehicle.source is not an address" in told
    assert "boat.toml:6: watch.age_days must be a number" in told
    assert "boat.toml:7: watch.dip_degree is not known, did you mean 'dip_deg'?" in told


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("[vehicle]\nrate_hz = 0", 2, "between 1 and 1000"),
        ("[vehicle]\nsystem = true", 2, "whole number"),
        ("[vehicle]\ncompasses = [4]", 2, "between 1 and 3"),
        ('[vehicle]\ncompasses = "all"', 2, "must be a list, each a whole number between 1 and 3"),
        ('[vehicle]\nsource = ""', 2, "must be a text that is not empty"),
        ('[vehicle]\nsource = "flight.tlog"', 2, "not a recording"),
        ('[http]\nlisten = "8808"', 2, "HOST:PORT"),
        ('[http]\nlisten = "127.0.0.1:99999"', 2, "0 to 65535"),
        ('[http]\nallowed_origins = ["boat.local"]', 2, "must be origins"),
        ('[http]\nframed_by = ["http://boat; script-src *"]', 2, "must be origins"),
        ('[heading]\npublish = "tcp:1.2.3.4:5"', 2, "udp:HOST:PORT"),
        ('[heading]\npublish = "udp:boat"', 2, "must be HOST:PORT"),
        ("[heading]\nrate = 3", 2, "(there are: publish"),
        ("\n\n[mavlink]\n\nstatustext = 1\n", 5, "true or false"),
        ("[vehicl]\nrate_hz = 3", 1, "did you mean 'vehicle'?"),
        ("[vehicle]\n[watch]\n[vehicle.source]\n", 3, "vehicle.source"),
        ("\n[vehicle.source.x]\n", 1, "vehicle.source"),
        ("\nvehicle = { rate_hz = 0 }", 2, "vehicle.rate_hz must be"),
        ("\n[[vehicle]]\nrate_hz = 3", 2, "every key stands in a table"),
        ("\nrate_hz = 3", 2, "every key stands in a table"),
    ],
)
def test_a_mistake_is_told_with_its_line(text: str, line: int, words: str) -> None:
    told = mistakes(text)
    assert f"boat.toml:{line}:" in told
    assert words in told


@pytest.mark.parametrize(
    ("key", "least", "most"),
    [
        ("vehicle.system", 0, 255),
        ("vehicle.rate_hz", 1.0, 1000.0),
        ("vehicle.speed", 0.01, 1000.0),
        ("mavlink.heading_hz", 0.0, 50.0),
        ("watch.field_percent", 0.5, 100.0),
        ("watch.dip_deg", 0.2, 90.0),
        *((f"watch.{name}_deg", 0.2, 180.0) for name in ("agreement", "gyro", "course", "current", "step")),
        ("watch.age_days", 0.01, 36500.0),
    ],
)
def test_a_number_is_taken_within_its_ends_and_not_beyond(key: str, least: float, most: float) -> None:
    table, name = key.split(".")
    step = 1 if isinstance(least, int) else 0.001
    for value in (least, most):
        assert getattr(getattr(parse_config(f"[{table}]\n{name} = {value}"), table), name) == value
    for value in (least - step, most + step):
        assert f"between {least:g} and {most:g}" in mistakes(f"[{table}]\n{name} = {value}")


def test_a_host_may_have_a_name_of_one_letter_and_none_without() -> None:
    assert parse_config('[http]\nallowed_hosts = ["b"]').http.allowed_hosts == ("b",)
    assert "not empty" in mistakes('[http]\nallowed_hosts = [""]')


def test_text_that_is_no_toml_is_told_with_its_line() -> None:
    assert "line 2" in mistakes('[vehicle]\nsource "x"\n')
    assert "too deep" in mistakes("a = " + "[" * 2000)


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be read"):
        load_config(tmp_path / "none.toml")
    (tmp_path / "latin.toml").write_bytes(b'[storage]\nfolder = "\xe9"')
    with pytest.raises(UsageError, match="UTF-8"):
        load_config(tmp_path / "latin.toml")


def test_data_lies_where_systemd_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", f"{tmp_path}/state:{tmp_path}/other")
    assert ServiceConfig().folder == tmp_path / "state"
    monkeypatch.delenv("STATE_DIRECTORY")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert ServiceConfig().folder == tmp_path / "mavcompass"


@pytest.mark.parametrize(
    ("text", "parts"),
    [("127.0.0.1:80", ("127.0.0.1", 80)), ("[::1]:8808", ("::1", 8808)), ("localhost:0", ("localhost", 0))],
)
def test_host_and_port_are_split(text: str, parts: tuple[str, int]) -> None:
    assert split_host_port(text) == parts


@pytest.mark.parametrize(
    ("listen", "is_open"),
    [("127.0.0.1:1", False), ("localhost:1", False), ("[::1]:1", False), ("0.0.0.0:1", True),
     ("boat:1", True)],
)  # fmt: skip
def test_a_page_open_to_the_network_is_known_as_such(listen: str, is_open: bool) -> None:
    assert parse_config(f'[http]\nlisten = "{listen}"').is_open_to_the_network is is_open
