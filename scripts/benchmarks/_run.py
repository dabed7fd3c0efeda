"""Run benchmarks, show what was wanted beside what was measured, and write everything as JSON.

    scripts/bench [NAME ...] [--quick] [--json FILE] [--list] [-- OPTIONS OF THE ONE BENCHMARK]

A benchmark is a file of this folder whose name does not begin with an underscore. Either it holds functions
for pytest-benchmark (the options are pytest's), whose best times are compared by CHECKS, dictionaries with
`what`, the names `of` one and `over` the other, and `at_least` or `at_most`; TIMER names another clock than
the wall's, and `extra_info["samples"]` says of how many the time is. Or it has a function

    main(argv: Sequence[str] | None = None) -> dict

that prints what it measures and returns it. Under "checks" it may list dictionaries with `what`, `value`
and `at_least` or `at_most`; under QUICK a module may name the options that make it short.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
import tempfile
import traceback
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType
from typing import Any

HERE = Path(__file__).resolve().parent
PROJECT = HERE.parents[1]
QUICK = ("--benchmark-max-time=0.2", "--benchmark-min-rounds=3")  # of pytest-benchmark
COMPARED = ("numpy", "scipy", "pymavlink", "pyulog", "mavsdk", "distributed", "pyarrow")


def names() -> list[str]:
    """Return the benchmarks of this folder."""
    return sorted(path.stem for path in HERE.glob("*.py") if not path.stem.startswith("_"))


def main(argv: Sequence[str] | None = None) -> int:
    """Run the benchmarks asked for; the exit code is 1 where one broke, not where a figure was missed."""
    parser = argparse.ArgumentParser(prog="scripts/bench", description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of: {', '.join(names())} (default: all)")
    parser.add_argument("--quick", action="store_true", help="shorter runs, less exact figures")
    parser.add_argument("--json", type=Path, default=PROJECT / "build" / "bench.json", help="result file")
    parser.add_argument("--list", action="store_true", help="list the benchmarks and leave")
    own, theirs = _split(list(sys.argv[1:] if argv is None else argv))
    options = parser.parse_args(own)
    if options.list:
        print("\n".join(names()))
        return 0
    chosen = options.names or names()
    if unknown := set(chosen) - set(names()):
        parser.error(f"there is no benchmark {', '.join(sorted(unknown))}; there are: {', '.join(names())}")
    if theirs and len(chosen) != 1:
        parser.error("options after -- need exactly one NAME")
    sys.path[:0] = [str(HERE), str(PROJECT)]
    results = {name: run(name, options.quick, theirs) for name in chosen}
    document = {"schema": "mavcompass.bench/1", "machine": machine(), "benchmarks": results}
    options.json.parent.mkdir(parents=True, exist_ok=True)
    options.json.write_text(json.dumps(document, indent=1) + "\n")
    show_checks(results)
    print(f"\nWritten: {options.json}")
    return 1 if any("broke" in result for result in results.values()) else 0


def _split(arguments: list[str]) -> tuple[list[str], list[str]]:
    cut = arguments.index("--") if "--" in arguments else len(arguments)
    return arguments[:cut], arguments[cut + 1 :]


def run(name: str, quick: bool, options: Sequence[str]) -> dict[str, Any]:
    """Run one benchmark; one that breaks does not stop the others."""
    print(f"\n=== {name}", flush=True)
    before = os.getloadavg()[0]
    try:
        module = import_module(name)
        measure = getattr(module, "main", None) or partial(timed, module)
        default_quick = () if hasattr(module, "main") else QUICK
        figures = measure([*(getattr(module, "QUICK", default_quick) if quick else ()), *options])
    except (Exception, SystemExit) as error:
        traceback.print_exc()
        figures = {"broke": f"{type(error).__name__}: {error}"}
    return {"load_before": before, "quick": quick, **figures}


def timed(module: ModuleType, options: Sequence[str]) -> dict[str, Any]:
    """Run a file of pytest-benchmark's; return the median and the best of each part, seconds."""
    import pytest

    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.json"
        words = [str(module.__file__), f"--rootdir={PROJECT}", "-q", "-p", "no:cacheprovider"]
        words += ["--benchmark-enable", "--benchmark-only", "--benchmark-columns=min,median,rounds"]
        words += [f"--benchmark-timer={getattr(module, 'TIMER', 'time.perf_counter')}"]
        if code := pytest.main([*words, f"--benchmark-json={result}", *options]):
            raise RuntimeError(f"pytest ended with {code!r}")
        found = json.loads(result.read_text())["benchmarks"]
    best = {
        one["param"] or one["name"]: one["stats"]["min"] / one["extra_info"].get("samples", 1)
        for one in found
    }
    checks = [
        {"value": best[check["of"]] / best[check["over"]], **check}
        for check in getattr(module, "CHECKS", ())
        if check["of"] in best and check["over"] in best
    ]
    medians = {one["name"]: one["stats"]["median"] for one in found}
    return {"median_s": medians, "best_s": best, "checks": checks}


def machine() -> dict[str, Any]:
    """Tell what the figures were measured on."""
    return {
        "system": platform.platform(),
        "processors": len(os.sched_getaffinity(0)),
        "python": platform.python_version(),
        "packages": {name: found for name in COMPARED if (found := _version(name)) is not None},
    }


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def show_checks(results: dict[str, dict[str, Any]]) -> None:
    """Print each figure beside what was wanted."""
    print(f"\n{'benchmark':10} {'measured':>12}   {'wanted':<14} {'':7} what")
    for name, result in results.items():
        if "broke" in result:
            print(f"{name:10} {'':>12}   {'':<14} {'BROKE':7} {result['broke']}")
        for check in result.get("checks", ()):
            least = "at_least" in check
            bound = check["at_least"] if least else check["at_most"]
            met = check["value"] >= bound if least else check["value"] <= bound
            verdict = "met" if met else "MISSED"
            wanted = f"{'>=' if least else '<='} {bound:g}"
            print(f"{name:10} {check['value']:12.4g}   {wanted:<14} {verdict:7} {check['what']}")


if __name__ == "__main__":
    sys.exit(main())
