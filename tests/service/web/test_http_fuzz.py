"""Requests made up from the OpenAPI description: none may bring the service to an internal error."""

from __future__ import annotations

import warnings
from typing import Any

import pytest
from running_service import RunningService

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # of the tool's own making
    schemathesis = pytest.importorskip("schemathesis")

import requests
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from hypothesis.errors import Unsatisfiable

BOUNDS = settings(
    max_examples=10,
    deadline=None,
    derandomize=True,
    phases=(Phase.generate,),
    suppress_health_check=list(HealthCheck),
)


@pytest.fixture(scope="module", autouse=True)
def no_long_calibrations(quiet: RunningService) -> None:
    """Let motions that the fuzzer starts end at once: the vehicle is disarmed, nobody turns it."""
    assert quiet.link is not None
    quiet.link.autopilot.disarm()  # type: ignore[attr-defined]


def probe(
    session: requests.Session, running: RunningService, operation: Any, mode: Any
) -> tuple[int, list[str]]:
    """Make requests for one operation; return how many, and which answers were not as described."""
    headers = {"authorization": f"Bearer {running.service.token}"}
    expected = {int(status) for status in operation.definition.raw["responses"]} | {404, 405, 503}
    strange: list[str] = []
    asked = 0

    @BOUNDS
    @given(case=operation.as_strategy(generation_mode=mode))
    def ask(case: Any) -> None:
        nonlocal asked
        asked += 1
        response = case.call(session=session, headers=headers)
        if response.status_code not in expected:
            strange.append(f"{operation.label}: {response.status_code} {response.text[:200]}")

    try:
        ask()
    except Unsatisfiable:
        pass  # nothing can be wrong with a request that has no parameters
    return asked, strange


@pytest.mark.filterwarnings("ignore")
def test_no_described_request_ends_in_an_internal_error(quiet: RunningService) -> None:
    schema = schemathesis.openapi.from_url(f"{quiet.service.url}openapi.json")
    asked, strange = 0, []
    with requests.Session() as session:
        session.trust_env = False
        for result in schema.get_all_operations():
            for mode in schemathesis.GenerationMode:
                more, wrong = probe(session, quiet, result.ok(), mode)
                asked += more
                strange += wrong
    assert strange == []
    assert asked > 200


@settings(BOUNDS, max_examples=150)
@given(
    path=st.text(st.characters(min_codepoint=33, max_codepoint=126), max_size=40),
    method=st.sampled_from(["GET", "POST", "PUT", "DELETE", "OPTIONS", "HEAD", "TRACE"]),
    body=st.binary(max_size=200),
)
def test_no_nonsense_ends_in_an_internal_error(
    quiet: RunningService, path: str, method: str, body: bytes
) -> None:
    address = "/" + path.lstrip("/").replace("#", "").replace("?", "/")
    answer = quiet.client.request(method, quiet.service.url.rstrip("/") + address, content=body)
    assert answer.status_code < 500 or answer.status_code == 503
