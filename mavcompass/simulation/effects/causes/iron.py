"""Iron and the sensor's geometry: affine maps of the field in body axes."""

from __future__ import annotations

import numpy as np

from mavcompass.frames import FloatArray, rotvec_to_matrix
from mavcompass.simulation.effects.effect import Effect, Stage, axes, on_iron, on_mag


def _soft_iron(field: FloatArray, theta: FloatArray) -> FloatArray:
    xx, yy, zz, xy, xz, yz = theta
    return field @ np.array([[1.0 + xx, xy, xz], [xy, 1.0 + yy, yz], [xz, yz, 1.0 + zz]])


def _non_orthogonality(field: FloatArray, theta: FloatArray) -> FloatArray:
    yx, zx, zy = theta[:3]
    return field @ np.array([[1.0, 0.0, 0.0], [yx, 1.0, 0.0], [zx, zy, 1.0]]).T


EFFECTS = (
    Effect(
        id="hard_iron",
        title="permanent magnetism fixed to the vehicle",
        stage=Stage.FIELD,
        parameters=axes(-1500.0, 1500.0, (60.0, -40.0, 20.0), 30.0, "mG"),
        forward=on_mag(lambda field, theta: field + theta),
        needs=frozenset({"turning"}),
        aliases=("hard_iron_step", "temperature_bias", "motor_current"),
        separated_by="turn through all headings, and tilt for the vertical part",
        source="raw = field + b; sizes of 5 to 300 mG are usual on vehicles",
        affine=True,
    ),
    Effect(
        id="soft_iron",
        title="magnetisable material around the sensor",
        stage=Stage.IRON,
        parameters=(
            *axes(-0.5, 0.5, (0.06, -0.05, 0.02), 0.03, "1", ("xx", "yy", "zz")),
            *axes(-0.3, 0.3, (0.04, -0.02, 0.03), 0.03, "1", ("xy", "xz", "yz")),
        ),
        forward=on_mag(_soft_iron),
        needs=frozenset({"turning", "tilt"}),
        aliases=("axis_scale", "non_orthogonality"),
        separated_by="tumble through all attitudes",
        source="raw = (I + E) m with E symmetric, 0.5 to 10 %",
        affine=True,
    ),
    Effect(
        id="axis_scale",
        title="gain error of each sensor axis",
        stage=Stage.MATRIX,
        parameters=(*axes(-0.5, 0.5, (0.05, -0.04, 0.02), 0.03, "1"), on_iron(False)),
        forward=on_mag(lambda field, theta: field * (1.0 + theta[:3])),
        needs=frozenset({"turning"}),
        aliases=("field_intensity", "inclination", "soft_iron"),
        separated_by="tumble, and visit a second site for the common part",
        source="raw_i = (1 + s_i) m_i, 0.5 to 5 %",
        affine=True,
    ),
    Effect(
        id="non_orthogonality",
        title="sensor axes not at right angles",
        stage=Stage.MATRIX,
        parameters=(
            *axes(-0.15, 0.15, (0.02, -0.015, 0.01), 0.015, "rad", ("yx", "zx", "zy")),
            on_iron(False),
        ),
        forward=on_mag(_non_orthogonality),
        needs=frozenset({"turning", "tilt"}),
        aliases=("soft_iron", "misalignment"),
        separated_by="tumble through all attitudes",
        source="lower triangular I + L; data sheets state 90 +/- 1 degree",
        affine=True,
    ),
    Effect(
        id="misalignment",
        title="the compass is turned against the body",
        stage=Stage.MOUNTING,
        parameters=(*axes(-0.5, 0.5, (0.02, -0.03, 0.06), 0.03, "rad"), on_iron(True)),
        forward=on_mag(lambda field, theta: field @ rotvec_to_matrix(theta[:3]).T),
        aliases=("declination", "attitude_reference_error", "non_orthogonality"),
        separated_by="tilt: about the vertical it is the declination exactly",
        source="raw = exp[w] m, 0.5 to 10 degrees",
        affine=True,
    ),
)
