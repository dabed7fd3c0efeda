"""Calibrate by one of magyc's methods; run by a Python that has magyc, not by this project's.

    python _peer_magyc.py METHOD SAMPLES.npz

SAMPLES holds `time_s` (N,), `mag_mgauss` (N, 3) and `gyro_radps` (N, 3). Prints one JSON object: the hard
iron (3,) in milligauss, the soft iron (3, 3) and the seconds that the method itself took.
"""

import json
import sys
import time
from typing import Any


def main(method: str, samples: str) -> None:
    """Run the method and print what it found."""
    import magyc
    import numpy as np

    data = np.load(samples)
    gauss = data["mag_mgauss"] * 1e-3
    inputs: tuple[Any, ...] = (gauss, data["gyro_radps"], data["time_s"])
    if method == "ellipsoid_fit":
        inputs = (gauss,)
    start = time.perf_counter()
    hard_iron, soft_iron, *_ = getattr(magyc, method)(*inputs)
    seconds = time.perf_counter() - start
    found = {
        "hard_iron_mgauss": (np.ravel(hard_iron) * 1e3).tolist(),
        "soft_iron": np.asarray(soft_iron).tolist(),
        "seconds": seconds,
    }
    print(json.dumps(found))


if __name__ == "__main__":
    main(*sys.argv[1:])
