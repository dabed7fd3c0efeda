"""Which of several compasses is wrong: the others, the gyro and the Earth's field as witnesses."""

from __future__ import annotations

import math

import pytest

from mavcompass.heading.witnesses import Tolerances, Witness, _apart_deg, who_is_wrong

FITS = {"dip_off_deg": 0.4, "strength_off_percent": -1.0}
BENT = {"dip_off_deg": 9.0, "strength_off_percent": 12.0}


def blamed(*witnesses: Witness) -> list[int]:
    return [blame.instance for blame in who_is_wrong(witnesses)]


def test_compasses_that_agree_blame_nobody() -> None:
    assert blamed(Witness(1, 359.0), Witness(2, 1.0), Witness(3, 0.5)) == []
    assert blamed(Witness(1, 100.0)) == blamed() == []


def test_two_that_agree_outvote_the_third_whichever_it_is() -> None:
    (blame,) = who_is_wrong([Witness(1, 334.0), Witness(2, 0.5, **FITS), Witness(3, 359.5, **FITS)])
    assert blame.instance == 1 and blame.apart_deg == pytest.approx(-26.0)
    agree = "2 and 3 agree with each other within 1.0 deg and with the Earth's dip and strength"
    assert blame.why == f"Compass 1 is off by 26 deg: {agree}."
    assert blamed(Witness(1, 0.0), Witness(2, 30.0), Witness(3, 1.0)) == [2]
    assert blamed(Witness(1, 0.0), Witness(2, 1.0), Witness(3, 181.0)) == [3]


def test_a_majority_bent_alike_does_not_convict_the_one_that_the_earth_bears_out() -> None:
    alike = [Witness(2, 30.0, **BENT), Witness(3, 31.0, **BENT)]
    assert blamed(Witness(1, 0.0, **FITS), *alike) == [2, 3]
    assert blamed(Witness(1, 0.0, **BENT), *alike) == [1]


def test_the_gyros_turn_decides_between_two() -> None:
    (blame,) = who_is_wrong([Witness(1, 12.0, turn_off_deg=-9.0), Witness(2, 0.0, turn_off_deg=0.5)])
    assert blame.instance == 1 and blame.apart_deg == pytest.approx(12.0)
    assert "its turn is 9 deg another than the gyro's, that of 2 is not" in blame.why


def test_the_turn_weighs_more_than_the_field() -> None:
    assert blamed(Witness(1, 12.0, turn_off_deg=0.1, **BENT), Witness(2, 0.0, turn_off_deg=7.0, **FITS)) == [
        2
    ]


def test_the_earths_field_decides_where_nobody_turned() -> None:
    (blame,) = who_is_wrong([Witness(1, 0.0, **FITS), Witness(2, 20.0, **BENT)])
    assert blame.instance == 2
    assert "its field is 9 deg in dip and 12 % in strength off the Earth's, and that of 1 fits" in blame.why


@pytest.mark.parametrize("known", [{}, FITS, BENT])
def test_two_with_the_same_record_leave_it_open(known: dict[str, float]) -> None:
    (blame,) = who_is_wrong([Witness(1, 0.0, **known), Witness(2, -12.0, **known)])
    assert blame.instance == 0 and blame.apart_deg == pytest.approx(-12.0)
    assert "a turn tells which is wrong" in blame.why


def test_three_that_all_differ_are_left_to_the_turn() -> None:
    three = [Witness(1, 0.0), Witness(2, 20.0), Witness(3, 40.0)]
    assert blamed(*three) == [0]
    turned = [
        Witness(1, 0.0, turn_off_deg=8.0),
        Witness(2, 20.0, turn_off_deg=0.2),
        Witness(3, 40.0, turn_off_deg=-6.0),
    ]
    assert blamed(*turned) == [1, 3]
    assert math.isclose(who_is_wrong(turned)[1].apart_deg, 20.0)


AT = {"turn_off_deg": 3.0, "dip_off_deg": -3.0, "strength_off_percent": 6.0}


@pytest.mark.parametrize(
    ("beyond", "wrong"),
    [
        ({}, []),
        ({"turn_off_deg": -3.01}, [1]),
        ({"turn_off_deg": math.nan}, []),
        ({"turn_off_deg": math.nan, "dip_off_deg": 3.01}, [1]),
        ({"turn_off_deg": math.nan, "strength_off_percent": -6.01}, [1]),
    ],
)
def test_what_lies_at_a_tolerance_is_within_it(beyond: dict[str, float], wrong: list[int]) -> None:
    other = {**AT, "turn_off_deg": beyond.get("turn_off_deg", 3.0)}
    if not math.isnan(other["turn_off_deg"]):
        other["turn_off_deg"] = 3.0
    assert blamed(Witness(1, 30.0, **AT | beyond), Witness(2, 0.0, **other)) == (wrong or [0])


@pytest.mark.parametrize(("apart_deg", "agree"), [(4.99, True), (5.01, False)])
def test_compasses_agree_within_five_degrees(apart_deg: float, agree: bool) -> None:
    for witnesses in (
        (Witness(1, 0.0), Witness(2, apart_deg)),
        (Witness(1, 358.0), Witness(2, apart_deg - 2.0)),
    ):
        assert blamed(*witnesses) == ([] if agree else [0])
    at = abs(_apart_deg(Witness(2, apart_deg), [Witness(1, 0.0)]))
    assert not who_is_wrong([Witness(1, 0.0), Witness(2, apart_deg)], Tolerances(apart_deg=at))


def test_the_sentences_name_compasses_and_figures() -> None:
    told = [Witness(1, 0.0), Witness(2, 0.0), Witness(3, 1.0), Witness(4, 90.0)]
    (blame,) = who_is_wrong(told)
    assert (blame.instance, blame.apart_deg) == (4, pytest.approx(90.0 - 1.0 / 3.0))
    assert blame.why == "Compass 4 is off by 90 deg: 1, 2 and 3 agree with each other within 1.0 deg."
    by_gyro = [Witness(1, 40.0, turn_off_deg=9.0), *(Witness(k, 0.0, turn_off_deg=0.1) for k in (2, 3))]
    (blame,) = who_is_wrong(by_gyro)
    assert blame.why.endswith("2 and 3 agree with each other within 0.1 deg and with the gyro.")
    (blame,) = who_is_wrong([Witness(5, 10.0), Witness(7, 350.0)])
    assert blame.why == "Compasses 5 and 7 point 20 deg apart; a turn tells which is wrong."
