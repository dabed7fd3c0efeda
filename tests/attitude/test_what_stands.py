"""How much of what a standing vehicle feels is gravity: a push that fades, noise, and a frame that turns."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mavcompass.attitude.standing import LOOK_S, Standing

STEP_S = 0.05
LOOKS = round(LOOK_S / STEP_S)


def looks_at(forces: list[complex], noise2: float = 0.0) -> list[tuple[complex, float]]:
    """Feel forces, one a step, and look whenever it is time."""
    standing, found = Standing(), []
    for force in forces:
        standing = standing.feeling(force, STEP_S)
        if standing.felt_s > LOOK_S - 0.5 * STEP_S:
            found.append(standing.gravity(noise2))
            standing = standing.looked()
    return found


def test_one_look_alone_tells_nothing_and_the_second_that_it_stands() -> None:
    first, second = looks_at([0.3 - 0.1j] * 2 * LOOKS)
    assert first[1] == math.inf
    assert second[0] == pytest.approx(0.3 - 0.1j) and math.sqrt(second[1]) == pytest.approx(0.01)


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize("fades_s", [0.7, 1.5, 2.0])
def test_a_push_that_fades_within_two_seconds_is_within_what_is_said_of_it(
    fades_s: float, backward: bool
) -> None:
    pushes = [0.5 * (0.8 + 0.6j) * math.exp(-STEP_S * k / fades_s) for k in range(6 * LOOKS)]
    found = looks_at(pushes[::-1] if backward else pushes)[1:]
    for mean, variance in found:
        assert abs(mean) < 1.4 * math.sqrt(2.0 * variance)
    assert found[0 if backward else -1][1] < 0.25 * max(variance for _, variance in found)


def test_standing_long_leaves_little_more_than_noise() -> None:
    rng, noise = np.random.default_rng(4), 0.05
    noise2, late = noise**2 / LOOKS, []
    for _ in range(50):
        forces = rng.normal(0.0, noise, (20 * LOOKS, 2)) @ (1.0, 1.0j)
        late += [variance for _, variance in looks_at(list(forces), noise2)[5:]]
    assert noise2 < np.mean(late) < 4.0 * noise2


def test_what_was_felt_leans_with_the_frame() -> None:
    standing = Standing()
    for _ in range(LOOKS):
        standing = standing.feeling(0.2 + 0.0j, STEP_S)
    leant = standing.looked().feeling(0.2 + 0.0j, 0.4).leant(-0.2j)
    mean, variance = leant.gravity(0.0)
    assert mean == pytest.approx(0.2 - 0.2j) and math.sqrt(variance) == pytest.approx(0.01)
