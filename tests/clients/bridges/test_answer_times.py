"""How long answers took, by a distribution that is kept up to date: against the times themselves."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_client.bridges.loop import AnswerTimes


@pytest.mark.parametrize("part", [0.5, 0.99])
def test_quantiles_are_those_of_the_last_answers(part: float) -> None:
    times, took_s = AnswerTimes(last=5000), np.random.default_rng(3).lognormal(np.log(2e-4), 0.7, 20_000)
    for one in took_s:
        times.note(float(one))
    found = times.quantile_s(part)
    assert found is not None
    assert abs(found / np.quantile(took_s[-5000:], part) - 1.0) < 0.025
    assert times.longest_s == took_s.max()


def test_there_is_none_before_the_first_answer_and_extremes_have_a_place() -> None:
    times = AnswerTimes()
    assert times.quantile_s(0.5) is None
    for one in (0.0, 1e-9, 0.0002, 60.0, 3600.0):
        times.note(one)
    assert times.quantile_s(0.5) == pytest.approx(0.0002, rel=0.025)
    assert times.quantile_s(1.0) is None or times.quantile_s(0.99) is not None
