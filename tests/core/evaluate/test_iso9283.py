"""Criteria of ISO 9283 against numbers worked out by hand, and refusals where the data fall short."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from kilter_core.errors import OptionError
from kilter_core.evaluate.iso9283 import DRIFT_S, METRICS, MetricNotSupportedError, Trial, criteria

Floats = NDArray[np.float64]
PAIR = np.array([[0.0, 0.0, 0.0], [0.3, 0.4, 0.0]])


def trial(off: Floats, pose: Any, **columns: Any) -> Trial:
    none = np.full(len(off), -1)
    base = Trial(np.zeros_like(off), off, None, np.asarray(pose), none, none, None)
    return replace(base, **columns)


def two_values(n: int = 30) -> Floats:
    """Offsets that alternate between (1, 0, 0) and (3, 0, 0) mm: barycentre 2 mm, every distance to it 1 mm."""
    return np.array([[1e-3 if k % 2 else 3e-3, 0.0, 0.0] for k in range(n)])


def test_pose_accuracy_and_repeatability() -> None:
    found = criteria(trial(two_values(), np.zeros(30, int)), ["AP", "RP"])["metrics"]
    assert found["AP"]["mm"] == pytest.approx(2.0)
    assert found["RP"]["mm"] == pytest.approx(1.0)  # every distance is 1 mm: no spread of distances
    assert found["AP"]["poses"][0]["xyz_mm"] == pytest.approx([2.0, 0.0, 0.0])
    assert found["AP"]["poses"][0]["n"] == found["AP"]["demands"] == 30
    spread = np.zeros((30, 3))
    spread[:, 1] = np.repeat([-3e-3, -1e-3, 0.0, 1e-3, 3e-3], 6)
    lengths = np.repeat([3.0, 1.0, 0.0, 1.0, 3.0], 6)
    s = np.sqrt(np.sum((lengths - 1.6) ** 2) / 29)
    found = criteria(trial(spread, np.zeros(30, int)), ["RP"])["metrics"]
    assert found["RP"]["mm"] == pytest.approx(1.6 + 3.0 * s)


def test_orientation() -> None:
    turned = np.zeros((30, 3))
    turned[:, 2] = np.radians(two_values()[:, 0] * 1e3)
    found = criteria(trial(two_values(), np.zeros(30, int), turned=turned))["metrics"]
    assert found["AP"]["poses"][0]["abc_deg"] == pytest.approx([0.0, 0.0, 2.0])
    assert found["RP"]["poses"][0]["abc_deg"] == pytest.approx([0.0, 0.0, 3.0 * np.sqrt(30.0 / 29.0)])


def test_multi_directional() -> None:
    off = np.repeat(np.array([[0.0, 0.0, 0.0], [1e-3, 0.0, 0.0], [0.0, 2e-3, 0.0]]), 30, axis=0)
    found = criteria(trial(off, np.zeros(90, int), approach=np.repeat([0, 1, 2], 30)), ["vAP"])["metrics"]["vAP"]
    assert found["mm"] == pytest.approx(np.sqrt(5.0))


def test_distances() -> None:
    pose = np.arange(60) % 2
    off = np.zeros((60, 3))
    off[pose == 1, 0] = 0.001 * 0.6
    off[pose == 1, 1] = 0.001 * 0.8  # 1 mm along the line from one pose to the other
    off[::4] -= off[1] * 0.5  # every second distance is half a millimetre longer
    found = criteria(trial(off, pose, commanded=PAIR[pose]), ["AD", "RD"])["metrics"]
    assert found["AD"]["mm"] == pytest.approx(1.25)
    assert found["RD"]["mm"] == pytest.approx(3.0 * 0.25 * np.sqrt(30.0 / 29.0))
    assert found["AD"]["commanded_mm"] == pytest.approx(500.0)


def test_paths() -> None:
    run, point = np.divmod(np.arange(40), 4)
    off = np.zeros((40, 3))
    off[:, 2] = np.where(point == 2, np.where(run % 2 == 0, 1e-3, 3e-3), 0.5e-3)
    found = criteria(trial(off, point, series=run), ["AT", "RT"])["metrics"]
    assert (found["AT"]["mm"], found["RT"]["mm"]) == pytest.approx((2.0, 1.0))
    assert (found["AT"]["points"], found["AT"]["n"]) == (4, 10)


def test_drift() -> None:
    series = np.repeat([0, 1, 2], 10)
    off = np.zeros((30, 3))
    off[:, 0] = np.repeat([1e-3, 1.5e-3, 1.2e-3], 10)
    t = np.linspace(0.0, DRIFT_S, 30)
    found = criteria(trial(off, np.zeros(30, int), series=series, t=t), ["dAP", "dRP"])["metrics"]
    assert found["dAP"]["mm"] == pytest.approx(0.5)
    assert found["dAP"]["series_mm"] == pytest.approx([1.0, 1.5, 1.2])
    assert found["dRP"]["mm"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("symbol", METRICS)
def test_what_the_data_cannot_support_is_refused_with_the_repeats_it_needs(symbol: str) -> None:
    few = trial(two_values(9), np.zeros(9, int), series=np.arange(9), t=np.arange(9.0))
    with pytest.raises(MetricNotSupportedError, match=rf"^{symbol} of ISO 9283") as refusal:
        criteria(few, [symbol])
    assert refusal.value.code == "metric_not_supported"
    assert refusal.value.context["repeats"] in (10, 30)
    with pytest.raises(MetricNotSupportedError, match="No criterion"):
        criteria(few)


def test_all_that_can_be_given_is_given_and_the_rest_has_reasons() -> None:
    found = criteria(trial(two_values(), np.zeros(30, int)))
    assert set(found["metrics"]) == {"AP", "RP"}
    assert {r["symbol"] for r in found["refused"]} == set(METRICS) - {"AP", "RP"}
    with pytest.raises(OptionError, match="XY"):
        criteria(trial(two_values(), np.zeros(30, int)), ["XY"])
