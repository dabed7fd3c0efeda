"""An MCAP file of a recording is a recording again, and tells headings and misfits as ROS 2 messages."""

from __future__ import annotations

import json
from collections import defaultdict
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

import mavcompass
from mavcompass.cli.main import main
from mavcompass.gap.trial.cases import Recipe, make_track
from mavcompass.logs import read_track
from mavcompass.report.bag import write_bag
from mavcompass.simulation import effects
from mavcompass.track import Track

bags = pytest.importorskip("rosbags.rosbag2")
typesys = pytest.importorskip("rosbags.typesys")


def read_by_its_own_definitions(path: Path) -> dict[str, list[Any]]:
    """Read a file as a stranger does: by the message definitions that stand in it."""
    types = typesys.get_typestore(typesys.Stores.EMPTY)
    found = defaultdict(list)
    with bags.Reader(path) as bag:
        for connection in bag.connections:
            types.register(typesys.get_types_from_msg(connection.msgdef.data, connection.msgtype))
        for connection, _, raw in bag.messages():
            found[connection.topic].append(types.deserialize_cdr(raw, connection.msgtype))
    return found


@pytest.fixture(scope="module")
def track() -> Track:
    return make_track(
        Recipe("yaw-steps", duration_s=60.0, seed=3), [effects.parse("hard_iron:x=30,y=-40,z=10")]
    )


@pytest.fixture(scope="module")
def written(track: Track, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bag") / "flight.mcap"
    write_bag(track, path)
    assert [p.name for p in path.parent.iterdir()] == ["flight.mcap"]
    return path


def test_what_was_written_is_a_recording_again(track: Track, written: Path) -> None:
    again = read_track(written)
    assert list(again.compasses) == [1]
    assert np.allclose(again.raw_field(), track.raw_field(), atol=1e-6)
    assert track.gyro_radps is not None and again.gyro_radps is not None and track.acc_mps2 is not None
    assert np.allclose(again.gyro_radps.values, track.gyro_radps.at(track.acc_mps2.time_s), atol=1e-9)
    alone = replace(track, reference_q=None, position_ned_m=None)
    one, other = mavcompass.calibrate(alone), mavcompass.calibrate(again)
    assert np.allclose(one.raw_offset_mgauss[:2], other.raw_offset_mgauss[:2], atol=0.1)


def test_headings_are_azimuths_in_degrees_clockwise_with_their_variance(track: Track, written: Path) -> None:
    told = read_by_its_own_definitions(written)["/compass_1/magnetic"]
    heading = mavcompass.heading(track)
    assert np.allclose([m.azimuth for m in told], np.degrees(heading.magnetic_rad))
    assert np.allclose(
        [m.variance for m in told], np.square(np.degrees(heading.magnetic_sigma_rad)), rtol=1e-6
    )
    assert {(m.unit, m.orientation, m.reference) for m in told} == {(1, 1, 0)}
    assert {m.reference for m in read_by_its_own_definitions(written)["/compass_1/true"]} == {1}


def test_the_layouts_name_what_is_in_the_file(written: Path) -> None:
    layouts = Path(__file__).parents[2] / "params" / "layouts"
    panels = json.loads((layouts / "foxglove.json").read_text())["configById"].values()
    wanted = {path["value"].replace(".", "/") for panel in panels for path in panel.get("paths", ())}
    assert wanted == {
        curve.get("name") for curve in ElementTree.parse(layouts / "plotjuggler.xml").iter("curve")
    }
    told = read_by_its_own_definitions(written)
    for name in wanted:
        _, compass, topic, *fields = name.split("/")
        assert isinstance(reduce(getattr, fields, told[f"/{compass}/{topic}"][0]), float)
    assert [panel["topicToRender"] for panel in panels if "topicToRender" in panel] == ["/diagnostics"]


def test_the_residual_is_what_the_iron_does_to_strength_and_dip(written: Path) -> None:
    told = read_by_its_own_definitions(written)
    field, residual = (
        np.array([[m.vector.x, m.vector.y, m.vector.z] for m in told[f"/compass_1/{name}"]])
        for name in ("field", "residual")
    )
    # By its own heading the compass sees nothing sideways; down the iron's 10 mG stay (up: -10).
    sideways = field[:, 0] * residual[:, 1] - field[:, 1] * residual[:, 0]
    assert np.median(np.abs(sideways) / np.linalg.norm(field[:, :2], axis=1)) < 1.0
    assert np.median(residual[:, 2]) == pytest.approx(-10.0, abs=3.0)


def test_a_compass_that_is_off_is_a_warning(written: Path) -> None:
    (array,) = read_by_its_own_definitions(written)["/diagnostics"]
    (status,) = array.status
    assert status.name == "Compass 1" and int(status.level) == 1
    assert "deg off before" in status.message


def test_the_command_writes_a_recording_and_refuses_a_live_vehicle(
    tmp_path: Path, track: Track, capsys: pytest.CaptureFixture[str]
) -> None:
    from mavcompass.logs.formats.csv.writer import write_track_csv

    write_track_csv(track, tmp_path / "flight.csv")
    out = tmp_path / "flight.mcap"
    assert main(["heading", str(tmp_path / "flight.csv"), "--mcap", str(out), "--json", "-"]) == 0
    assert f"Written: {out}" in capsys.readouterr().err
    assert len(read_by_its_own_definitions(out)["/compass_1/magnetic"]) == len(track.compasses[1].reported)
    assert main(["heading", "sim:rover", "--mcap", str(out)]) == 2
    assert "--mcap needs a recording" in capsys.readouterr().err
    assert main(["heading", str(tmp_path / "flight.csv"), "--mcap", str(tmp_path / "no" / "x.mcap")]) == 2
