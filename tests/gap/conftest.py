"""Every diagnosis that these tests make, for whatever reason, is checked for contradictions."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from agreement import check

from mavcompass.gap import Diagnosis, diagnose
from mavcompass.gap.answer.decision import Answer
from mavcompass.gap.answer.description import describe
from mavcompass.gap.answer.evidence import Evidence


def checked(evidence: Evidence, answer: Answer) -> Diagnosis:
    diagnosis = describe(evidence, answer)
    check(diagnosis, evidence)
    return diagnosis


@pytest.fixture(scope="module", autouse=True)
def no_contradiction() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(diagnose, "describe", checked)
        yield
