"""Sets of three effects that a search reaches only by exchanging two for one, or by geometry that its priors hold."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.gap.search.linear.bases import FIRM, apart
from tests.blind.generator import cases
from tests.blind.run import run_case


@pytest.mark.parametrize(
    ("name", "hidden"),
    [
        # Beside a base that bends the zero of joint 1 seemed nothing: a direction of the geometry that one prior deviation
        # moves by 0.56 of a data deviation was free, and both followed it. The drift of six numbers that imitates the two
        # was exchanged for no pair.
        ("0303-three-seven-60", {"column_bending": None, "zero_thermal": [1], "second_harmonic": [6]}),
        # A coupling of joint 4 stood for two effects at joints 2 and 3 that together leave a tenth of what it leaves.
        ("0014-three-seven-30", {"axial_compliance": [4], "encoder_scale": [2], "link_bending": [3]}),
    ],
)
def test_what_imitates_two_effects_is_exchanged_for_both(name: str, hidden: dict[str, list[int] | None]) -> None:
    case = next(case for case in cases(20261128, 320) if case.name == name)
    report = run_case(case)["report"]
    assert {e["id"]: e["joints"] for e in report["effects"]} == hidden


def test_directions_are_told_apart_by_what_the_data_know_of_them() -> None:
    rng = np.random.default_rng(4)
    Q, _ = np.linalg.qr(rng.standard_normal((40, 5)))
    V, _ = np.linalg.qr(rng.standard_normal((5, 5)))
    sizes = np.array([1e5, 2.0 * FIRM, 0.5 * FIRM, 0.56, 1e-6])
    firm, weak = apart(Q * sizes @ V.T)
    assert firm.shape == weak.shape == (5, 2)
    assert np.abs(V[:, :2].T @ firm @ firm.T @ V[:, :2]) == pytest.approx(np.eye(2), abs=1e-6)
    assert np.abs(V[:, 2:4].T @ weak @ weak.T @ V[:, 2:4]) == pytest.approx(np.eye(2), abs=1e-6)
    assert apart(np.zeros((40, 0)))[0].shape == (0, 0)
