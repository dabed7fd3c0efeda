"""Regenerate the results of the three papers this project implements, as figures and as numbers.

    scripts/reproduce [--out FOLDER] [--data FOLDER]

Writes one PNG per figure and reproduce.json, which holds our numbers beside the paper's. Where a paper
shows measurements that it does not print, the figure is made from simulated data and, for the level turn,
from a real HMC5883L as well.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

PROJECT = HERE.parents[1]


def main() -> int:
    """Make all figures; print the numbers."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=PROJECT / "build" / "reproduce")
    parser.add_argument(
        "--data",
        type=Path,
        default=Path(os.environ.get("MAVCOMPASS_SHARED_DATA") or PROJECT.parent / "shared" / "data"),
        help="folder of the shared recordings, for the real level turn",
    )
    options = parser.parse_args()
    os.environ.setdefault("MPLBACKEND", "Agg")
    import four_positions_figure
    import sensitivity_figures
    import tilt_figures

    options.out.mkdir(parents=True, exist_ok=True)
    results: dict[str, Any] = {"schema": "mavcompass.reproduce/1", "figures": {}, "tables": {}}
    figures, tables = results["figures"], results["tables"]
    figures["four-positions-fig2-simulated"] = four_positions_figure.simulated(options.out)
    figures["four-positions-fig2-hmc5883l"] = four_positions_figure.real(options.out, options.data)
    figures |= tilt_figures.draw(options.out)
    tables["two-axis-z-error-bound"] = tilt_figures.bound()
    figures |= sensitivity_figures.draw(options.out)
    tables["bicycle"] = sensitivity_figures.bicycle()
    target = options.out / "reproduce.json"
    target.write_text(json.dumps(results, indent=1) + "\n")
    _print(results)
    print(f"\nwritten to {options.out}")
    return 0


def _print(results: dict[str, Any]) -> None:
    for kind in ("figures", "tables"):
        for name, entry in results[kind].items():
            print(f"{name}: {entry['about']}")
            for side in ("ours", "paper"):
                shown = ", ".join(f"{k} {_text(v)}" for k, v in entry.get(side, {}).items())
                print(f"  {side:5} {shown or entry.get('skipped', '-')}")


def _text(value: Any) -> str:
    return f"{value:.3f}" if isinstance(value, float) else str(value)


if __name__ == "__main__":
    raise SystemExit(main())
