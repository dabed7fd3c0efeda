"""ArduPilot's simulator, by its parameters, compass 1.

It makes raw = E^-1 field - OFS with E symmetric (SIM_MAG1_DIA, SIM_MAG1_ODI). With raw = A field + b and the
polar form A = P R: E = P^-1, OFS = -b; the rotation R it does not have.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.export.exported import Exported, Found, commented
from mavcompass.gap.export.vehicle import affine_map

SIMULATOR = "ArduPilot's simulator"
_AXES = "XYZ"
_ROTATION_WORTH_SAYING_RAD = math.radians(0.1)


@dataclass(frozen=True, slots=True, eq=False)
class Affine:
    """Hold what the simulator makes of a field: raw = P field + b, and the turn (rad) that it leaves out."""

    stretch: FloatArray
    offset_mgauss: FloatArray
    left_out_rad: float

    def parameters(self) -> dict[str, float]:
        """Return its parameters.

        Elements of the matrix come all together: the firmware ignores one of which only some are set.
        """
        cure = np.linalg.inv(self.stretch)
        out = {f"SIM_MAG1_OFS_{axis}": float(-self.offset_mgauss[i]) for i, axis in enumerate(_AXES)}
        out |= {f"SIM_MAG1_DIA_{axis}": float(cure[i, i]) for i, axis in enumerate(_AXES)}
        places = zip(_AXES, ((0, 1), (0, 2), (1, 2)), strict=True)
        return out | {f"SIM_MAG1_ODI_{axis}": float(cure[i, j]) for axis, (i, j) in places}

    @property
    def left_out(self) -> list[str]:
        """List the effects that the simulator does not have of it."""
        return ["misalignment"] if self.left_out_rad > _ROTATION_WORTH_SAYING_RAD else []

    def lacking(self) -> list[str]:
        """Say what of it the simulator does not have."""
        if not self.left_out:
            return []
        return [
            f"A rotation of the compass by {math.degrees(self.left_out_rad):.2f} degrees: the simulator turns"
            " its compass only in steps (SIM_MAG1_ORIENT)."
        ]


def affine_of(found: Found) -> Affine | None:
    """Compose all affine effects; None where there is none."""
    affine = [s for s in found.settings if s.effect.affine]
    if not affine:
        return None
    matrix, offset = affine_map(affine)
    u, sizes, vt = np.linalg.svd(matrix)
    angle = math.acos(float(np.clip((np.trace(u @ vt) - 1.0) / 2.0, -1.0, 1.0)))
    return Affine(u @ np.diag(sizes) @ u.T, offset, angle)


def ardupilot_sitl(found: Found) -> Exported:
    """Write a parameter file that ArduPilot's simulator and ground stations load."""
    affine = affine_of(found)
    parameters = affine.parameters() if affine is not None else {}
    lacking = [*(affine.lacking() if affine is not None else []), *found.of_the_place(SIMULATOR)]
    left_out = affine.left_out if affine is not None else []
    for setting in found.settings:
        if setting.effect.sitl is not None:
            parameters |= setting.effect.sitl(setting.values)
        elif not setting.effect.affine:
            lacking.append(found.without(setting, SIMULATOR))
            left_out.append(setting.effect.id)
    lines = commented("#", found.headed(SIMULATOR))
    lines += commented("# not in the simulator:", lacking)
    lines += [f"{name},{value:.6g}" for name, value in parameters.items()]
    use = "sim_vehicle.py --add-param-file=FILE"
    return Exported("\n".join(lines) + "\n", use, parameters, tuple(lacking), tuple(left_out))
