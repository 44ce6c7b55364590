"""How the client follows answers that change faster than they may: on a straight way, marked, and with what it lags by."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

from kilter_client.stream import CorrectedStream
from kilter_client.streaming.frames import DAMPED, SATURATED, SLOWED, Answer, Setpoint
from tests.corrector.test_acceptance import Q, announced, answered, asked, stream_of

PERIOD_S = 0.002
DEG = math.radians(1.0)


def an_answer(stream: CorrectedStream, delta: tuple[float, ...], flags: int = 0, left_nm: int = 0) -> Answer:
    answer = stream._accept(answered(asked(stream), 0.0))
    assert answer is not None
    q = tuple(w + d for w, d in zip(Q, delta, strict=True))
    return answer._replace(q=q, flags=flags, left_nm=left_nm)


def followed(stream: CorrectedStream, delta: tuple[float, ...], flags: int = 0, left_nm: int = 0) -> Setpoint:
    return stream._carried.follow(Q, an_answer(stream, delta, flags, left_nm), 1e-3, PERIOD_S, 0.0)


def test_all_joints_go_the_same_share_of_their_way() -> None:
    rng = random.Random(5)
    stream = stream_of(settled=True)
    at = np.array(followed(stream, (0.0,) * 5).delta)
    sources = set()
    for k in range(500):
        size = rng.choice((1e-3, 0.02, 1.0))
        to = np.array([rng.uniform(-0.9, 0.9) * DEG * size for _ in range(4)] + [rng.uniform(-4e-3, 4e-3) * size])
        setpoint = followed(stream, tuple(to))
        moved, way = np.array(setpoint.delta) - at, to - at
        share = np.dot(moved, way) / np.dot(way, way)
        assert 0.0 < share <= 1.0 + 1e-9
        assert np.allclose(moved, share * way, rtol=0, atol=1e-12), k
        rates = np.abs(moved) / PERIOD_S
        assert rates[:4].max() <= 5.0 * DEG * 1.00001
        assert rates[4] <= 25e-3 * 1.0001
        # It goes as far as it may: where it lags, one joint is at its bound.
        assert share > 1.0 - 1e-9 or max(rates[:4].max() / (5.0 * DEG), rates[4] / 25e-3) > 0.999
        assert setpoint.slowed == (setpoint.source == "slowed") == (share < 1.0 - 1e-9)
        assert np.allclose(np.array(setpoint.delta) + setpoint.lag, to, rtol=0, atol=1e-12)
        sources.add(setpoint.source)
        at = np.array(setpoint.delta)
    assert sources == {"corrected", "slowed"}
    statistics = stream.statistics
    assert (statistics.corrected + statistics.slowed, statistics.slowed > 100) == (501, True)


def test_between_two_corrections_that_leave_the_tool_in_place_it_stays_in_place() -> None:
    """Joints 4 and 6 of a wrist whose axes nearly coincide swing against each other: the rotation of the tool is their sum."""
    stream = stream_of(settled=True)
    followed(stream, (0.0, 0.0, 0.0, 0.0, 0.0))
    worst = 0.0
    for k in range(400):
        swing = 0.8 * DEG if k < 200 else -0.8 * DEG
        delta = followed(stream, (swing, 0.0, 0.0, -swing, 0.0)).delta
        worst = max(worst, abs(delta[0] + delta[3]))
    assert worst < 1e-12
    assert delta[0] == pytest.approx(-0.8 * DEG)
    assert stream.statistics.slowed > 50


def test_only_what_the_corrector_answered_is_called_corrected() -> None:
    stream = stream_of(settled=True, hold_cycles=1, release_s=0.05)
    first = followed(stream, (0.5 * DEG, 0.0, 0.0, 0.0, 0.0), DAMPED, 310_000)
    assert (first.source, first.damped, first.saturated, first.left_mm) == (
        "corrected",
        True,
        False,
        pytest.approx(0.31),
    )
    assert (first.lag, first.lag_mm) == ((0.0,) * 5, 0.0)
    leap = followed(stream, (-0.5 * DEG, 0.0, 0.0, 0.0, 0.0), SATURATED, 2_000)
    assert (leap.source, leap.slowed, leap.saturated, leap.left_mm) == ("slowed", True, True, None)
    assert leap.lag[0] == pytest.approx(-(1.0 - 5.0 * PERIOD_S) * DEG)
    held = stream._carried.hold(Q, None)
    assert (held.source, held.left_mm, held.lag, held.lag_mm, held.damped) == ("held", None, (), None, False)
    assert stream._carried.hold(Q, None).source == "bypass"
    back = followed(stream, (-0.5 * DEG, 0.0, 0.0, 0.0, 0.0))
    assert (back.source, back.left_mm) == ("slowed", None)  # it fades in
    while back.source == "slowed":
        back = followed(stream, (-0.5 * DEG, 0.0, 0.0, 0.0, 0.0))
        assert tuple(back) == tuple(Q[k] + back.delta[k] for k in range(5)) or back.source == "corrected"
    assert back.delta[0] == pytest.approx(-0.5 * DEG)
    by_corrector = followed(stream, (-0.5 * DEG, 0.0, 0.0, 0.0, 0.0), SLOWED, 40_000)
    assert (by_corrector.source, by_corrector.slowed, by_corrector.left_mm) == ("corrected", True, pytest.approx(0.04))
    said = stream.statistics.document()
    assert said["held_back"] == {"damped": 1, "saturated": 1, "slowed": 1}
    assert said["most_left_mm"] == pytest.approx(0.31)


def test_an_answer_after_a_miss_at_the_very_start_is_taken_as_it_is() -> None:
    stream = stream_of(hold_cycles=10)
    assert stream._carried.hold(Q, None).source == "bypass"  # nothing to hold yet
    assert followed(stream, (1e-5,) * 5).source == "corrected"
    assert stream.statistics.slowed == 0


def test_the_rate_is_that_of_the_version_and_never_above_the_caller_s() -> None:
    for announced_deg, announced_mm, options, most_deg, most_mm in (
        (2.0, 10.0, {}, 2.0, 10.0),
        (50.0, 1000.0, {}, 25.0, 50.0),  # 5 deg and 10 mm in 0.2 s
        (50.0, 1000.0, {"largest_deg": 3.0, "largest_mm": 10.0, "quickest_s": 0.1}, 30.0, 100.0),
        (5.0, 25.0, {"largest_deg": 30.0}, 5.0, 25.0),
        ("fast", math.nan, {}, 2.5, 12.5),  # not numbers: the version's largest in the quickest time
        (-1.0, None, {}, 2.5, 12.5),
    ):
        largest = 30.0 if options else 0.5
        document = announced(
            largest_deg=largest, largest_mm=5 * largest, rate_deg_s=announced_deg, rate_mm_s=announced_mm
        )
        stream = stream_of(document, **options)
        assert stream._in_use.motion_share == (0.1 if most_deg == 2.5 else 0.0)
        assert stream._in_use.rates == pytest.approx((most_deg * DEG,) * 4 + (most_mm * 1e-3,), rel=1e-6)


def test_the_lag_at_the_tool_is_told_where_the_corrector_says_how_far_the_joints_move_it() -> None:
    levers = [800.0, 700.0, 400.0, 100.0, 1.0]
    delta = (0.5 * DEG, -0.5 * DEG, 0.0, 0.2 * DEG, 1e-3)
    for document, told in (
        (announced(levers_mm=levers), True),
        (announced(), False),
        (announced(levers_mm=[1.0]), False),
    ):
        stream = stream_of(document, settled=True)
        followed(stream, (0.0,) * 5)
        setpoint = followed(stream, delta)
        assert setpoint.source == "slowed"
        expected = sum(
            abs(x) * lever * (1000.0 if k == 4 else 1.0)
            for k, (x, lever) in enumerate(zip(setpoint.lag, levers, strict=True))
        )
        assert setpoint.lag_mm == (pytest.approx(expected) if told else None)


def test_a_cycle_that_begins_late_is_not_slowed() -> None:
    """Setpoints that act 2 ms apart but are sent 1 to 3 ms apart: what counts is when they act, as for the corrector."""
    stream = stream_of()
    rng = random.Random(2)
    now = 10**12
    stream._sent_ns = now
    stream._pause_s(now, now)
    for k in range(1, 100):
        last, stream._sent_ns = stream._sent_ns, now + k * 2_000_000 + rng.randrange(1_000_000)
        assert stream._pause_s(last, now + k * 2_000_000) == pytest.approx(PERIOD_S)
    last, stream._sent_ns = stream._sent_ns, stream._sent_ns + 2_000_000
    assert stream._pause_s(last, 10**15) == pytest.approx(
        PERIOD_S + 0.1
    )  # no further ahead than the corrector believes
    last, stream._sent_ns = stream._sent_ns, stream._sent_ns + 2_000_000
    assert stream._pause_s(last, 5) == pytest.approx(PERIOD_S)  # a clock that was set back
    last, stream._sent_ns = stream._sent_ns, stream._sent_ns + 3_000_000
    assert stream._pause_s(last, 0) == pytest.approx(0.003)  # nothing is said of when it acts


def test_a_chunk_says_how_far_it_lags(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = stream_of(settled=True)
    rows = [Q] * 50
    steady = an_answer(stream, (0.0,) * 5, DAMPED, 5000)._replace(q=Q * 50, points=50)
    monkeypatch.setattr(stream, "_ask", lambda *_, **__: (steady, 1e-3))
    plain = stream.correct_chunk(rows, PERIOD_S)
    assert plain is not None
    assert (plain.lag, plain.slowed, plain.damped, plain.left_mm) == (0.0, False, True, pytest.approx(0.005))
    leap = steady._replace(q=tuple(w + d for w, d in zip(Q, (0.3 * DEG, 0.1 * DEG, 0.0, 0.0, 0.0), strict=True)) * 50)
    monkeypatch.setattr(stream, "_ask", lambda *_, **__: (leap, 1e-3))
    slow = stream.correct_chunk(rows, PERIOD_S)
    assert slow is not None
    assert (slow.slowed, slow.left_mm) == (True, None)
    assert 0.28 * DEG < slow.lag <= 0.3 * DEG
    given = np.array(slow.q).reshape(50, 5) - Q
    assert np.allclose(given[:, 1], given[:, 0] / 3.0, rtol=0, atol=1e-12)
    assert np.allclose(given[-1, :2], np.array([0.3, 0.1]) * DEG)
