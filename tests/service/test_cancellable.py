"""Computations that are left at once when the job is cancelled."""

from __future__ import annotations

import threading

import pytest

from kilter_core.errors import CancelledError
from kilter_service.jobs.kind import Progress
from kilter_service.jobs.kinds.gap import cancellable


def test_the_result_and_the_error_come_through() -> None:
    told: list[tuple[float, str]] = []

    def compute(report: Progress) -> int:
        report(0.5, "half")
        return 7

    assert cancellable(compute, lambda fraction, stage: told.append((fraction, stage))) == 7
    assert told[-1] == (0.5, "half")
    with pytest.raises(ZeroDivisionError):
        cancellable(lambda report: 1 / 0, lambda fraction, stage: None)


def test_a_cancelled_job_is_left_though_a_step_goes_on() -> None:
    going_on, ended = threading.Event(), threading.Event()

    def compute(report: Progress) -> None:
        try:
            going_on.wait(30)
            report(0.9, "late")
        finally:
            ended.set()

    def cancel(fraction: float, stage: str) -> None:
        raise CancelledError("cancelled")

    with pytest.raises(CancelledError):
        cancellable(compute, cancel)
    assert not ended.is_set()
    going_on.set()
    assert ended.wait(10)
