"""Sets of effects that a search reaches only by an exchange, by what is likely beforehand, or by what its priors hold."""

from __future__ import annotations

import numpy as np
import pytest

from kilter_core.gap.search.linear.gram import FIRM, split_geometry_directions
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
        pytest.param(
            "0014-three-seven-30",
            {"axial_compliance": [4], "encoder_scale": [2], "link_bending": [3]},
            marks=pytest.mark.slow,
        ),
    ],
)
def test_what_imitates_two_effects_is_exchanged_for_both(name: str, hidden: dict[str, list[int] | None]) -> None:
    case = next(case for case in cases(20261128, 320) if case.name == name)
    report = run_case(case)["report"]
    assert {e["id"]: e["joints"] for e in report["effects"]} == hidden


@pytest.mark.parametrize(
    ("name", "hidden"),
    [
        # Torsion of the link and compliance of the joint behind it leave the same to 0.5 points of chi-square.
        ("0468-two-seven-60", {"axial_compliance": [3], "clearance_tilt": [4]}),
        # Eighteen steps of a walk cost as much as if all rows told each of them, and six numbers of a settling stood for it.
        pytest.param("0063-two-elbow-60", {"random_walk": None, "direction_compliance": [6]}, marks=pytest.mark.slow),
        # Of the load across the last joint only one component differs from pose to pose: its tilt was asked for by both.
        pytest.param("0281-two-katana-60", {"random_walk": None, "reading_tilt": [5]}, marks=pytest.mark.slow),
        # A field of six numbers that follows the temperature stood for both, and so did what was tried first beside one.
        pytest.param(
            "0132-three-seven-118",
            {"column_bending": None, "direction_compliance": [5], "link_growth": [1]},
            marks=pytest.mark.slow,
        ),
        # Once torsion of the link stood for the compliance, errors of the masses imitated it through what had left the set.
        pytest.param(
            "0589-three-seven-60", {"second_harmonic": [5], "direction_compliance": [4]}, marks=pytest.mark.slow
        ),
    ],
)
def test_names_are_found_among_others_as_good(name: str, hidden: dict[str, list[int] | None]) -> None:
    case = next(case for case in cases(20261128, 600) if case.name == name)
    found = {e["id"]: e["joints"] for e in run_case(case)["report"]["effects"]}
    assert found.items() >= hidden.items()


def test_directions_are_told_apart_by_what_the_data_know_of_them() -> None:
    rng = np.random.default_rng(4)
    Q, _ = np.linalg.qr(rng.standard_normal((40, 5)))
    V, _ = np.linalg.qr(rng.standard_normal((5, 5)))
    sizes = np.array([1e5, 2.0 * FIRM, 0.5 * FIRM, 0.56, 1e-6])
    firm, weak = split_geometry_directions(Q * sizes @ V.T)
    assert firm.shape == weak.shape == (5, 2)
    assert np.abs(V[:, :2].T @ firm @ firm.T @ V[:, :2]) == pytest.approx(np.eye(2), abs=1e-6)
    assert np.abs(V[:, 2:4].T @ weak @ weak.T @ V[:, 2:4]) == pytest.approx(np.eye(2), abs=1e-6)
    assert split_geometry_directions(np.zeros((40, 0)))[0].shape == (0, 0)
