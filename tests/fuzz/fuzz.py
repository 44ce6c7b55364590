"""Send requests of every kind and collect those that are not answered as promised."""

from __future__ import annotations

import logging
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import httpx
from hypothesis import HealthCheck, Phase, given, seed, settings

from tests.fuzz.answers import Answers
from tests.fuzz.requests import Case, Requests
from tests.fuzz.world import World


class Outcome(NamedTuple):
    """How many requests were answered with which status, and one case of each kind of fault."""

    statuses: Counter[int]
    faults: dict[str, str]


def fuzz(world: World, cases: int, seed_: int = 0) -> Outcome:
    """Send ``cases`` requests; the same seed sends the same, as far as ids and answers are the same."""
    interface = world.client.get("/openapi.json").raise_for_status().json()
    requests, answers = Requests(interface, world.known), Answers(interface)
    outcome = Outcome(Counter(), {})

    causes = _Causes()

    @seed(seed_)
    @settings(
        max_examples=cases,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(requests.case())
    def send(case: Case) -> None:
        try:
            answer = _sent(world.client, case)
        except httpx.TransportError as error:
            outcome.faults.setdefault(f"{case.method} {case.path}: {type(error).__name__}", f"{case!r:.1500}")
            return
        outcome.statuses[answer.status_code] += 1
        fault = answers.fault(case.method, case.path, answer)
        if fault is not None:
            fault = causes.last if answer.status_code == 500 else fault
            outcome.faults.setdefault(f"{case.method} {case.path}: {fault}", f"{case!r:.1500}")

    with warnings.catch_warnings(), causes:
        warnings.simplefilter("ignore")  # Hypothesis warns of strategies that draw large values
        send()
    return outcome


class _Causes(logging.Handler):
    """The cause of the last status 500, from the log of the server in this process."""

    last = "status 500 without a word in the log"

    def emit(self, record: logging.LogRecord) -> None:
        """Keep where an exception was raised."""
        if record.exc_info and record.exc_info[1] is not None:
            error = record.exc_info[1]
            places = [f"{Path(one.filename).name}:{one.lineno}" for one in traceback.extract_tb(error.__traceback__)]
            if record.levelno >= logging.ERROR:
                self.last = f"500 by {type(error).__name__} at {' < '.join(places[:-4:-1])}: {str(error)[:100]!r}"

    def __enter__(self) -> None:
        logger = logging.getLogger("kilter.api")
        logger.addHandler(self)
        logger.propagate = False

    def __exit__(self, *_: object) -> None:
        logger = logging.getLogger("kilter.api")
        logger.removeHandler(self)
        logger.propagate = True


def _sent(client: httpx.Client, case: Case) -> httpx.Response:
    return client.request(case.method, case.address, content=case.content, headers=case.headers)
