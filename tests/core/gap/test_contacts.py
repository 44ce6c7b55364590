"""A gap search on sockets, planes and bars: a hidden eccentricity of an arm that Pinocchio holds there, and a clean one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.arm.documents import robot_from_document
from kilter_core.errors import ObservationError
from kilter_core.gap import GapOptions, GapReport, find_gap
from kilter_core.gap.check import check_gap
from kilter_core.gap.study import split_held_out_rows
from kilter_core.observations import Observations
from tests.core.campaigns import held, measured
from tests.core.measurement.test_contacts import PLACES, PLAY, about, bars, in_sockets, pair, with_play

Floats = NDArray[np.float64]
SIX = np.vstack([PLACES, [[0.6, -0.2, 0.3], [0.5, 0.1, 0.7], [0.7, 0.3, 0.2]]])
PLANES = (([0, 0, 1.0], 0.3), ([1.0, 0, 0], 0.6), ([0, 1.0, 0], 0.1), ([0.6, 0, 0.8], 0.65), ([0, 0.6, 0.8], 0.4))
HIDDEN, PHASE = 1e-3, 0.4  # rad
AGAIN = 6  # poses of each placement that are approached three times
OPTIONS = GapOptions(resamples=20, permutations=5, bootstraps=199)


def read_by(q: Floats, amplitude: float) -> Floats:
    """What the encoder of joint 2 reads where its disk is eccentric and the joints stand at ``q``."""
    read = q.copy()
    for _ in range(30):
        read[:, 1] = q[:, 1] - amplitude * np.sin(read[:, 1] + PHASE)
    return read


def repeated(number: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows in the order they are measured: all of them, then some of each placement twice more."""
    some = np.concatenate([np.flatnonzero(number == k)[:AGAIN] for k in np.unique(number)])
    return np.concatenate([np.arange(len(number)), some, some])


def sockets(amplitude: float, seed: int = 1, places: Floats = SIX) -> tuple[Any, Observations]:
    rng = np.random.default_rng(seed)
    drawn, actual = pair()
    q, number = in_sockets(actual, rng, places, 20)
    order = repeated(number)
    read = read_by(with_play(actual, q[order], rng), amplitude)
    return robot_from_document(drawn.document()), Observations(read, socket=number[order])


def on_planes(amplitude: float, seed: int = 1) -> tuple[Any, Observations]:
    rng = np.random.default_rng(seed)
    drawn, actual = pair()
    q, number = [], []
    for k, (normal, distance) in enumerate(PLANES, 1):
        n = np.array(normal)
        found = held(actual, about(rng, 50, 0.9), lambda p, n=n, d=distance: (np.array([n @ p - d]), n[None]))
        q.append(found)
        number += [k] * len(found)
    order = repeated(np.array(number))
    read = read_by(with_play(actual, np.concatenate(q)[order], rng), amplitude)
    return robot_from_document(drawn.document()), Observations(read, plane=np.array(number)[order])


def at_bars(amplitude: float, seed: int = 1) -> tuple[Any, Observations]:
    rng = np.random.default_rng(seed)
    drawn, actual = pair()
    feet = np.array([[0.5, 0.5, 0.0], [0.9, -0.3, 0.1], [0.6, 0.1, 0.1], [0.4, -0.4, 0.0]])
    rows = bars(rng, actual, feet, 50)
    assert rows.bar is not None
    rows, bar = rows.select(repeated(rows.bar)), rows.bar[repeated(rows.bar)]
    length = np.linalg.norm(actual.poses(rows.q)[0] - feet[bar - 1], axis=1)
    measured_mm = length + rng.normal(0.0, PLAY, len(rows))
    return robot_from_document(drawn.document()), replace(rows, q=read_by(rows.q, amplitude), bar_length=measured_mm)


def search(robot: Any, rows: Observations) -> GapReport:
    return find_gap(robot, rows, OPTIONS)


@pytest.fixture(scope="module")
def named() -> GapReport:
    return search(*sockets(HIDDEN))


def test_a_hidden_eccentricity_is_named_from_sockets(named: GapReport) -> None:
    found = named.to_document()
    (effect,) = found["effects"]
    members = {(effect["id"], *effect["joints"]), *((a["id"], *a["joints"]) for a in effect["alias_set"])}
    assert ("eccentricity", 2) in members
    assert effect["verdict"] in ("confirmed", "class_confirmed")
    amounts = {p["name"]: p for p in effect["parameters"]}
    for name, true in (("eccentricity_sin_2", np.cos(PHASE)), ("eccentricity_cos_2", np.sin(PHASE))):
        assert abs(amounts[name]["value"] - np.degrees(HIDDEN * true)) < 4.0 * amounts[name]["sigma"]
        assert amounts[name]["sigma"] < 0.05 * np.degrees(HIDDEN)
    assert found["where"][0]["factor"] == "angle of joint 2"
    assert found["verdict"] == "closed"


def test_the_noise_is_that_of_repeats_in_the_same_placement(named: GapReport) -> None:
    assert named.noise["source"] == "repeats"
    assert named.noise["re_approach_mm"] == pytest.approx(PLAY * 1e3, rel=0.15)


def test_errors_are_said_by_kind(named: GapReport) -> None:
    (contacts,) = named.measurements
    gap = named.gap
    assert (contacts["kind"], contacts["unit"]) == ("contacts", "mm")
    assert contacts["noise"] == pytest.approx(PLAY * 1e3, rel=0.15)
    for key in ("before", "after", "validation_before", "validation_after"):
        assert contacts[key] == pytest.approx(gap[f"{key}_mm"], rel=1e-6)


def test_the_gap_closes_on_placements_that_were_held_out_whole(named: GapReport) -> None:
    gap = named.to_document()["gap"]
    assert gap["held_out"].endswith("contacts and ball fitted to them")
    assert gap["validation_before_mm"] > 3.0 * gap["validation_noise_rms_mm"]
    assert gap["validation_after_mm"] == pytest.approx(gap["validation_noise_rms_mm"], rel=0.2)
    assert gap["closure"] > 0.95
    _, rows = sockets(HIDDEN)
    inside, outside = split_held_out_rows(rows, None, 0)
    assert outside is not None
    assert inside.socket is not None
    assert outside.socket is not None
    assert not set(inside.socket) & set(outside.socket)


def test_what_contacts_cannot_tell_is_said(named: GapReport) -> None:
    codes = {w["code"]: w for w in named.warnings}
    assert "a_2" in codes["scale_held"]["message"]
    assert named.next_poses == []
    assert "no_next_poses" in codes
    model = named.calibration.model
    length = named.calibration.values[model.names.index("a_2")]
    assert abs(length - model.values0()[model.names.index("a_2")]) < 5e-3


@pytest.mark.parametrize("made", [sockets, on_planes, at_bars])
def test_nothing_is_named_on_a_clean_arm(made: Any) -> None:
    report = search(*made(0.0, 1))
    assert report.verdict == "no_gap"
    assert not report.effects


@pytest.mark.parametrize("made", [on_planes, at_bars])
def test_planes_and_bars_name_it_too(made: Any) -> None:
    found = search(*made(HIDDEN)).to_document()
    (effect,) = found["effects"]
    assert effect["joints"] == [2]
    assert ("eccentricity", [2]) in [
        (effect["id"], effect["joints"]),
        *((a["id"], a["joints"]) for a in effect["alias_set"]),
    ]


def test_other_sockets_on_another_day_confirm_it() -> None:
    robot, rows = sockets(HIDDEN)
    _, again = sockets(HIDDEN, 5, SIX[:3] + np.array([0.05, 0.02, -0.04]))
    (effect,) = find_gap(robot, rows, OPTIONS, confirmation=again).effects
    assert effect.evidence.replication is not None
    assert effect.evidence.replication.outcome == "replicated"
    _, without = sockets(0.0, 5, SIX[:3] + np.array([0.05, 0.02, -0.04]))
    (effect,) = find_gap(robot, rows, OPTIONS, confirmation=without).effects
    assert effect.evidence.replication is not None
    assert effect.evidence.replication.outcome == "contradicted"


def test_what_can_be_tested_is_said_before() -> None:
    robot, rows = sockets(0.0)
    assert "eccentricity" in [v.id for v in check_gap(robot, rows, OPTIONS).testable]


def test_what_cannot_be_searched_together_is_refused() -> None:
    robot, rows = sockets(0.0)
    drawn, _ = pair()
    zero = np.zeros(len(rows), dtype=np.int64)
    assert rows.socket is not None
    mixed = replace(rows, socket=np.where(rows.socket < 6, rows.socket, 0), plane=np.where(rows.socket == 6, 1, zero))
    with pytest.raises(ObservationError, match="sockets apart from planes") as refused:
        find_gap(robot, mixed, OPTIONS, validation=0.0)
    assert refused.value.code == "contacts_mixed"
    seen = measured(drawn, rows.q[:30], np.random.default_rng(0))
    flat = replace(rows, q=rows.q + 0.01, socket=None, plane=rows.socket)
    for searched, validating in ((rows, seen), (seen, rows), (rows, flat)):
        with pytest.raises(ObservationError, match="in different ways") as refused:
            find_gap(robot, searched, OPTIONS, validation=validating)
        assert refused.value.code == "contacts_mixed"
