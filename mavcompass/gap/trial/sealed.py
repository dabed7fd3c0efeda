"""Make the cases of a blind trial and seal their labels.

A folder of sealed cases holds `0000.npz` ... (recording and baseline, without loss and without a word about
the cause), `labels.json`, and `seal`, the SHA-256 of salt and labels. Whoever diagnoses reads the seal and
the recordings; the labels are opened afterwards and must still have that hash.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Mapping
from dataclasses import asdict, fields
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mavcompass.correction import FieldCorrection
from mavcompass.frames import FloatArray
from mavcompass.gap.trial import bench, foreign
from mavcompass.gap.trial.label import Generator, Tier
from mavcompass.track import InForce, MagSeries, Series, Track

_NAMES = ("recording", "baseline")
# `source` and `notes` are words of who made the case.
_KEPT_BACK = frozenset({"truth_q", "source", "notes"})


def seal(
    folder: Path, cases: int, seed: int, tier: Tier | None = None, generator: Generator = "bench"
) -> str:
    """Write the cases and the sealed labels; return the seal."""
    draw = bench.draw_case if generator == "bench" else partial(foreign.draw_case, generator)
    labels = []
    for index in range(cases):
        label, track, baseline = draw(seed, index, tier)
        write_case(folder / f"{index:04d}.npz", track, baseline)
        labels.append(asdict(label))
    salt = secrets.token_hex(16)
    text = json.dumps({"salt": salt, "labels": labels})
    (folder / "labels.json").write_text(text, encoding="utf-8")
    digest = hashlib.sha256(text.encode()).hexdigest()
    (folder / "seal").write_text(digest + "\n", encoding="utf-8")
    return digest


def write_case(path: Path, recording: Track, baseline: Track) -> None:
    """Write both tracks to one file: every column, and the rest as JSON."""
    arrays: dict[str, FloatArray] = {}
    rest: dict[str, object] = {}
    for name, track in zip(_NAMES, (recording, baseline), strict=True):
        rest[name] = {
            key: _split(getattr(track, key), f"{name}/{key}", arrays)
            for key in (f.name for f in fields(Track))
            if key not in _KEPT_BACK
        }
    np.savez(path, rest=np.array(json.dumps(rest)), **arrays)  # type: ignore[arg-type]


def read_case(path: Path) -> tuple[Track, Track]:
    """Read a case: recording and baseline."""
    with np.load(path) as archive:
        rest = json.loads(str(archive["rest"]))
        recording, baseline = (_track(rest[name], name, archive) for name in _NAMES)
    return recording, baseline


def _split(value: object, place: str, arrays: dict[str, FloatArray]) -> object:
    """Put series among the arrays; return what JSON holds in their place, or the value itself."""
    if isinstance(value, Series):
        arrays[f"{place}/time_s"], arrays[f"{place}/values"] = value.time_s, value.values
        return place
    if isinstance(value, MagSeries):
        own = {f.name: getattr(value, f.name) for f in fields(MagSeries)}
        own["reported"] = _split(value.reported, place, arrays)
        own["in_force"] = [asdict(step) for step in value.in_force]
        own["not_applied"] = None if value.not_applied is None else asdict(value.not_applied)
        return own
    if isinstance(value, Mapping):
        return {str(key): _split(one, f"{place}/{key}", arrays) for key, one in value.items()}
    return value


def _track(rest: dict[str, Any], name: str, archive: Mapping[str, FloatArray]) -> Track:
    def series(place: str) -> Series:
        return Series.of(archive[f"{place}/time_s"], archive[f"{place}/values"])

    values: dict[str, Any] = {
        key: series(value) if isinstance(value, str) and value.startswith(f"{name}/") else value
        for key, value in rest.items()
    }
    values["compasses"] = {
        int(instance): MagSeries(
            **{
                **own,
                "reported": series(own["reported"]),
                "in_force": tuple(
                    InForce(s["from_s"], _correction(s["correction"])) for s in own["in_force"]
                ),
                "not_applied": None if own["not_applied"] is None else _correction(own["not_applied"]),
            }
        )
        for instance, own in rest["compasses"].items()
    }
    return Track(source=name, **values)


def _correction(values: dict[str, Any]) -> FieldCorrection:
    own: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
    return FieldCorrection(**own)
