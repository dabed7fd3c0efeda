"""What is said of vehicles beside something that the catalogue lacks, and that hardly shows."""

from __future__ import annotations

from mavcompass.gap import Diagnosis
from mavcompass.gap.diagnose import diagnose_gap
from mavcompass.gap.trial.vehicles import make_case


def found_in(seed: int, tier: str, withheld: str | None = None) -> Diagnosis:
    case = make_case(seed, tier)  # type: ignore[arg-type]
    return diagnose_gap(case.track, case.baseline, [withheld] if withheld else [])


def test_what_healthy_vehicles_do_not_leave_is_told_above_the_floor() -> None:
    found = found_in(1133840770, "outside")
    assert 0.0 < found.field.nominal - found.field.floor < 1.0  # mG
    assert found.verdict == "unknown" and not found.causes


def test_a_name_that_bends_what_is_known_is_not_sure() -> None:
    # Iron that is withheld: a gain does the same, if the calibration in force was far off.
    found = found_in(92214, "single", "hard_iron")
    assert found.verdict == "ambiguous"


def test_a_magnet_on_a_wheel_at_one_speed_is_not_surely_a_line() -> None:
    found = found_in(5037, "outside")
    assert found.verdict == "ambiguous" and found.ambiguity_set == ((("ac_interference",), 1.0),)
    assert any("another speed" in note for note in found.notes)


def test_a_line_beside_a_remainder_may_be_of_a_wheel_as_well() -> None:
    found = found_in(15008, "outside")
    assert found.verdict == "named_with_remainder" and found.unknown
    assert any("another speed" in note for note in found.notes)


def test_a_level_that_is_off_between_two_silences_is_no_step() -> None:
    """A healthy copter: what its attitude errs by for some seconds left twice what healthy ones leave."""
    found = found_in(1720382549, "none")
    assert found.verdict == "no_gap" and not found.causes


def test_what_goes_with_the_temperature_below_the_floor_is_not_silent() -> None:
    found = found_in(139429531, "single")
    assert found.field.nominal < 1.1 * found.field.floor
    assert found.verdict == "ambiguous"
    assert ("temperature_sensitivity",) in dict(found.ambiguity_set)


def test_structure_along_the_motion_is_no_silence_below_the_floor() -> None:
    """A sensor that saturates a little: all that is left goes with the heading."""
    found = found_in(1287283669, "outside")
    assert found.field.nominal < found.field.floor
    assert found.verdict == "unknown" and not found.causes


def test_a_name_that_leaves_nearly_all_that_is_loud_does_not_stand() -> None:
    # Saturation, too: readings that are cut off hold a tenth of what is left.
    found = found_in(87780570, "outside")
    assert found.verdict == "unknown" and not found.causes


def test_a_rover_that_rocks_has_no_noisier_compass() -> None:
    assert found_in(1186737630, "none").verdict == "no_gap"
    late = found_in(540504279, "single")
    assert late.verdict == "named" and late.effects == {"transport_lag"}
