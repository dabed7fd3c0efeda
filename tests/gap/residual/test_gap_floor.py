"""What a floor is made of: errors of headings beside errors of the field."""

from __future__ import annotations

import numpy as np
import pytest

from mavcompass.gap.replay.nominal import replay
from mavcompass.gap.residual.floor import heading_error_rad, heading_scatter, rms
from mavcompass.gap.trial.vehicles import make_case


@pytest.mark.parametrize("seed", [41, 304241175])
def test_a_heading_scatters_as_readings_do_behind_their_calibration(seed: int) -> None:
    here = replay(make_case(seed, "none").track)
    field, rng = here.measured.mag_mgauss, np.random.default_rng(seed)
    told = 0.5 * rms(heading_scatter(here, field))
    drawn = [
        rms(heading_error_rad(here, field + 0.5 * rng.standard_normal(field.shape), field)) for _ in range(20)
    ]
    assert told == pytest.approx(float(np.mean(drawn)), rel=0.03)
