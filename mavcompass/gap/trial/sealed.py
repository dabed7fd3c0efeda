"""Make the cases of a blind trial and seal their labels.

A folder of sealed cases holds `0000.npz` ... (recording and baseline, without a word about the cause),
`labels.json`, and `seal`, the SHA-256 of salt and labels. Whoever diagnoses reads the seal and the
recordings; the labels are opened afterwards and must still have that hash.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from dataclasses import asdict
from functools import partial
from pathlib import Path

from mavcompass.gap.trial import bench, foreign
from mavcompass.gap.trial.label import Generator, Tier
from mavcompass.gap.trial.stored import write_case


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
