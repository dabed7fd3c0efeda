"""A fleet from recordings to the table: nothing lost, nothing done twice."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from fleet_samples import look_or_die, looked_at, mark_and_look

from mavcompass.errors import LinkError, UsageError
from mavcompass.fleet.columns import columns_of
from mavcompass.fleet.engine import Engine
from mavcompass.fleet.examine import Job
from mavcompass.fleet.recordings import Recording, find_recordings
from mavcompass.fleet.run import Progress, journal_of, run_fleet

pq = pytest.importorskip("pyarrow.parquet", reason="pip install 'mavcompass[fleet]'")

CALIBRATE = Job("calibrate")
ONE, TWO = (Engine(workers=n, timeout_s=120.0) for n in (1, 2))


@pytest.fixture
def own_four(own_twelve: list[Recording]) -> list[Recording]:
    """The first four of them alone."""
    for recording in own_twelve[4:]:
        Path(recording.path).unlink()
    return own_twelve[:4]


@pytest.fixture
def own_twelve(twelve: Path, tmp_path: Path) -> list[Recording]:
    """The twelve as links in one folder, so that a test may add to it."""
    for path in twelve.rglob("*.csv"):
        os.link(path, tmp_path / f"{path.parent.name}-{path.name}")
    return find_recordings([str(tmp_path)])


def test_the_table_has_the_documented_columns_and_a_row_each(
    own_twelve: list[Recording], tmp_path: Path
) -> None:
    seen: list[Progress] = []
    out = tmp_path / "out.parquet"
    result = run_fleet(CALIBRATE, own_twelve, out, TWO, on_progress=seen.append)
    table = pq.read_table(out)
    assert table.column_names == [column.name for column in columns_of("calibrate")]
    assert table["recording"].to_pylist() == [recording.path for recording in own_twelve]
    assert set(table["status"].to_pylist()) == {"ok"}
    assert all(abs(offset - 10.0) < 3.0 for offset in table["offset_y_mgauss"].to_pylist())
    assert (result.examined, result.kept) == (12, 0)
    assert sorted({p.done for p in seen}) == list(range(13))


def test_a_recording_that_kills_its_process_is_one_error_and_the_others_are_done(
    own_four: list[Recording], tmp_path: Path
) -> None:
    deadly = tmp_path / "deadly.csv"
    deadly.write_bytes(Path(own_four[0].path).read_bytes())
    recordings = find_recordings([str(tmp_path)])
    run_fleet(CALIBRATE, recordings, tmp_path / "out.parquet", TWO, examine_one=look_or_die)
    table = pq.read_table(tmp_path / "out.parquet")
    assert Counter(table["status"].to_pylist()) == {"ok": 4, "error": 1}
    row = next(row for row in table.to_pylist() if row["status"] == "error")
    assert (row["recording"], row["error_kind"]) == (str(deadly), "WorkerDied")
    assert "signal 11" in row["error"]


def test_the_same_on_a_dask_cluster(own_four: list[Recording], tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    (tmp_path / "deadly.csv").write_bytes(Path(own_four[0].path).read_bytes())
    recordings = find_recordings([str(tmp_path)])
    here = str(Path(__file__).parent)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, env={"PYTHONPATH": here}
    ) as cluster:
        engine = Engine(scheduler=cluster.scheduler_address, timeout_s=120.0)
        run_fleet(CALIBRATE, recordings, tmp_path / "out.parquet", engine, examine_one=look_or_die)
    table = pq.read_table(tmp_path / "out.parquet")
    assert Counter(table["status"].to_pylist()) == {"ok": 4, "error": 1}
    assert "WorkerDied" in table["error_kind"].to_pylist()


def test_a_scheduler_that_is_not_there_is_said(
    own_four: list[Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr("mavcompass.fleet.engine._CONNECT_S", 0.5)
    engine = Engine(scheduler="tcp://127.0.0.1:9")
    with pytest.raises(LinkError, match="No Dask scheduler answers"):
        run_fleet(CALIBRATE, own_four, tmp_path / "out.parquet", engine)


KILLED = """
import sys
from pathlib import Path
from functools import partial
from fleet_samples import mark_and_look
from mavcompass.fleet.examine import Job
from mavcompass.fleet.recordings import find_recordings
from mavcompass.fleet.engine import Engine
from mavcompass.fleet.run import run_fleet
folder = Path(sys.argv[1])
run_fleet(Job("calibrate"), find_recordings([str(folder)]), folder / "out.parquet", Engine(2),
          examine_one=partial(mark_and_look, "begun"))
"""


def test_a_run_that_was_killed_goes_on_and_does_nothing_twice(
    own_twelve: list[Recording], tmp_path: Path, start_process: Callable[..., subprocess.Popen[str]]
) -> None:
    out = tmp_path / "out.parquet"
    journal = journal_of(out)
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    running = start_process(sys.executable, "-c", KILLED, str(tmp_path), env=environment)
    while running.poll() is None:
        if journal.exists() and journal.read_bytes().count(b"\n") >= 4:
            break
        time.sleep(0.002)
    running.kill()
    running.wait()
    kept = {json.loads(line)["recording"] for line in journal.read_bytes().splitlines(keepends=True)[1:]
            if line.endswith(b"\n")}  # fmt: skip
    assert 3 <= len(kept)
    with journal.open("ab") as file:
        file.write(b'{"recording": "/torn')
    again = partial(mark_and_look, "begun-again")
    result = run_fleet(CALIBRATE, own_twelve, out, TWO, examine_one=again)
    assert result.kept == len(kept) and result.examined == 12 - len(kept)
    begun_again = (tmp_path / "begun-again").read_text().split()
    assert sorted(begun_again) == sorted(Path(r.path).name for r in own_twelve if r.path not in kept)
    assert pq.read_table(out).num_rows == 12


def test_an_interrupt_leaves_a_state_to_go_on_from(own_four: list[Recording], tmp_path: Path) -> None:
    out = tmp_path / "out.parquet"

    def interrupt(progress: Progress) -> None:
        if progress.done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_fleet(CALIBRATE, own_four, out, TWO, on_progress=interrupt, examine_one=looked_at)
    assert not out.exists()
    result = run_fleet(CALIBRATE, own_four, out, TWO, examine_one=looked_at)
    assert (result.kept, result.examined) == (2, 2)


def test_only_what_changed_is_done_again(own_four: list[Recording], tmp_path: Path) -> None:
    out = tmp_path / "out.parquet"
    run_fleet(CALIBRATE, own_four, out, ONE)
    path = Path(own_four[3].path)
    content = path.read_bytes()
    path.unlink()
    path.write_bytes(content[: len(content) // 20])
    result = run_fleet(CALIBRATE, find_recordings([str(tmp_path)]), out, ONE)
    assert (result.kept, result.examined) == (3, 1)
    rows = pq.read_table(out).to_pylist()
    assert [row["status"] for row in rows].count("error") == 1 and len(rows) == 4
    result = run_fleet(CALIBRATE, find_recordings([str(tmp_path)]), out, ONE, retry_errors=True)
    assert result.examined == 1


def test_another_question_to_the_same_output_is_refused_unless_fresh(
    own_four: list[Recording], tmp_path: Path
) -> None:
    out = tmp_path / "out.parquet"
    run_fleet(CALIBRATE, own_four[:1], out, ONE, examine_one=looked_at)
    other = Job("calibrate", method="sphere")
    with pytest.raises(UsageError, match="--fresh"):
        run_fleet(other, own_four[:1], out, ONE)
    assert run_fleet(other, own_four[:1], out, ONE, fresh=True, examine_one=looked_at).examined == 1


def test_missing_pyarrow_is_said_before_the_work(
    own_four: list[Recording], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(UsageError, match="pip install 'mavcompass\\[fleet\\]'"):
        run_fleet(CALIBRATE, own_four, tmp_path / "out.parquet", TWO)
    assert not journal_of(tmp_path / "out.parquet").exists()
