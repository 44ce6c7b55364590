"""An effect rises on its own evidence where something else is left: halves of a campaign, and a confirmation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from kilter_core.arm.documents import robot_from_document
from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.evidence.halves import _Searched, restrict_to_visits
from kilter_core.gap.report.report import GapReport
from kilter_core.gap.search.candidates import FAMILY, JOINT, Candidate
from kilter_core.gap.search.linear.gram import Gram
from kilter_core.gap.search.prepare import prepare_data
from kilter_core.gap.search.scan import Scorer
from kilter_core.gap.search.select import Selector
from kilter_core.model import Calibration
from kilter_core.observations import Observations
from tests.core.gap import many_joints
from tests.core.gap.simulated import campaign, katana

NAMES = ("axial_compliance", "backlash", "eccentricity", "unknown_smooth_curve", "unknown_field")
QUICK = GapOptions(effects=NAMES, resamples=20, permutations=5, bootstraps=499, next_poses=0)
COMPLIANCE = ("axial_compliance", (1,), (6e-4,))


def rough(rows: Observations, size_m: float = 1e-4) -> Observations:
    """An error of no library, rough over the workspace: steps with one joint times a wave of another."""
    assert rows.position is not None
    wave = np.sign(np.sin(5.0 * rows.q[:, 2])) * np.cos(3.0 * rows.q[:, 1])
    return replace(rows, position=rows.position + size_m * wave[:, None] * np.array([1.0, 0.5, -0.7]))


@pytest.fixture(scope="module")
def beside() -> GapReport:
    return find_gap(katana(), rough(campaign(katana(), [COMPLIANCE], poses=100, seed=1)), QUICK)


def test_an_effect_that_lasts_rises_as_its_class_beside_what_else_is_left(beside: GapReport) -> None:
    (effect,) = beside.effects
    assert beside.adequacy.adequate is False
    assert effect.verdict == "class_confirmed"
    assert effect.claim.said == "class"  # two loads would name it, but it may be a part of what is left
    told = beside.to_document()["effects"][0]["halves"]
    assert told["named"] == [True, True]
    assert told["joints"] == [2]
    assert told["with_mm"] < told["without_mm"]
    assert told["apart_sigma"] < 3.0
    assert "adequate" not in effect.gates


def test_the_model_as_a_whole_has_a_statement_of_its_own(beside: GapReport) -> None:
    whole = beside.to_document()["adequacy"]
    assert whole["sentence"].startswith("Something else remains (")
    assert beside.verdict == "unexplained"
    assert "confirmed as a class; something else remains" in beside.sentence
    clean = find_gap(katana(), campaign(katana(), [COMPLIANCE], seed=1), QUICK).to_document()
    assert clean["adequacy"]["sentence"] == "The model as a whole agrees with the rows."
    assert clean["adequacy"]["mostly_at"] is None
    assert [e["halves"] for e in clean["effects"]] == [None]


def test_an_effect_of_one_half_alone_does_not_last() -> None:
    """The joint gives way in the first half of the campaign only: bolts that somebody tightened."""
    soft, stiff = (rough(campaign(katana(), hidden, poses=100, seed=4)) for hidden in ([COMPLIANCE], []))
    assert soft.position is not None
    assert stiff.position is not None
    first = np.arange(100)[soft.pose_id] < 50
    rows = replace(
        soft,
        position=np.where(first[:, None], soft.position, stiff.position),
        t=1000.0 * (~first) + np.arange(len(first)),
    )
    report = find_gap(katana(), rows, QUICK)
    assert report.adequacy.adequate is False
    about = [j for j in report.effects if j.evidence.candidate.id == "axial_compliance"]
    assert all(j.verdict == "provisional" for j in about)


def test_what_is_left_alone_confirms_nothing() -> None:
    for seed in (5, 6):
        report = find_gap(katana(), rough(campaign(katana(), [], poses=100, seed=seed)), QUICK)
        assert [j.claim.words for j in report.effects if j.verdict != "provisional"] == []


def test_seen_again_beside_what_is_left_is_replicated_and_no_more_than_the_class() -> None:
    rows, other = (rough(campaign(katana(), [COMPLIANCE], poses=n, seed=s, arm=1)) for n, s in ((100, 1), (40, 2)))
    report = find_gap(katana(), rows, QUICK, confirmation=other)
    effect = next(j for j in report.effects if j.evidence.candidate.id == "axial_compliance")
    assert effect.verdict == "replicated"
    assert effect.claim.said == "class"
    assert effect.evidence.replication is not None
    told = effect.evidence.replication.guarded
    assert told is not None
    assert told.with_it < told.without
    assert "replicated; something else remains" in report.sentence


@pytest.mark.parametrize("seed", range(4))
def test_a_half_of_a_clean_campaign_leaves_its_noise(seed: int) -> None:
    """Chi-square of a half over its freedom is one: with the freedom of all rows, noise looked like a third of itself."""
    made = many_joints.campaign(seed, 7, {})
    robot = robot_from_document(made.document)
    problem = prepare_data(Calibration.nominal(robot), Observations(**made.columns), QUICK).problem
    first = problem.settings.group < 39
    scale = (problem.settings.noise.coordinate / many_joints.NOISE_M) ** 2
    for side in (first, ~first):
        gram, numbers = restrict_to_visits(problem, side)
        rows = problem.G[side[problem.row_visit]]
        assert numbers == 3 * int(side.sum())
        rank = np.linalg.matrix_rank(rows * problem.settings.source.prior_sigma, tol=1e-3)
        assert gram.nu == pytest.approx(numbers - rank, abs=1.0)
        assert gram.yy * scale / gram.nu == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / gram.nu))


def test_halves_say_at_which_joints_of_a_family_they_agree() -> None:
    """Play at all joints, at one of which only in the first half of the campaign."""
    play = 4e-4 * np.array([1.0, -1.0, 1.0, 1.2, 1.5, 2.0, 4.0])
    before, after = (
        many_joints.campaign(3, 7, {"backlash": one}, same_sides=False)
        for one in (play, np.where(np.arange(7) == 3, 0.0, play))
    )
    first = before.columns["pose_id"] < 39
    position = np.where(first[:, None], before.columns["position"], after.columns["position"])
    rows = Observations(**before.columns | {"position": position, "t": 1000.0 * ~first + np.arange(len(first))})
    options = replace(QUICK, effects=("backlash",))
    report = find_gap(robot_from_document(before.document), rows, options, validation=0)
    (effect,) = report.effects
    assert effect.evidence.candidate.joints == tuple(range(7))
    told = effect.evidence.halves
    assert told is not None
    assert told.named == (True, True)
    assert told.joints == (0, 1, 2, 4, 5, 6)
    assert told.to_document()["joints"] == [1, 2, 3, 5, 6, 7]
    assert not told.lasts  # its amount at joint 4 is not the same


@pytest.mark.parametrize(("size", "came"), [(3.5, True), (0.0, False)])
def test_an_effect_too_faint_to_be_named_in_a_half_can_come_again_there(size: float, came: bool) -> None:
    """Three joints together are beyond chance, but not the best of a library at one in a billion."""
    rng = np.random.default_rng(2)
    W = rng.standard_normal((100, 4))
    W /= np.linalg.norm(W, axis=0)
    y = W[:, :3] @ np.full(3, size) + rng.standard_normal(100)
    gram = Gram(W.T @ W, W.T @ y, float(y @ y), 100.0)
    family = Candidate("backlash", (0, 1, 2), (0, 1, 2), FAMILY, False, False, "joint", ())
    single = Candidate("backlash", (0,), (0,), JOINT, False, False, "joint", ())
    selector = Selector(Scorer.from_candidates([family, single], True, np.inf), 100, np.full(4, np.inf))
    assert selector.select_candidates(gram, 1e-9, 4) == ()
    half = _Searched(gram, selector, ())
    assert half.matching_candidates(0, ()) == ([family] if came else [])
    beside = _Searched(gram, selector, (1,))  # with one of its joints in, the others still have to be there
    assert beside.matching_candidates(0, ()) == [single]


def test_a_wave_beside_a_curve_of_its_own_joint_is_replicated_as_the_curve_that_both_are() -> None:
    """A disc off its centre, and a belt with three waves a turn at the same joint, which no cause of the library has."""
    disc = ("eccentricity", (0,), (4e-4, 3e-4))
    found = []
    for poses, seed in ((100, 1), (40, 2)):
        rows = campaign(katana(), [disc], poses=poses, seed=seed, arm=1)
        assert rows.position is not None
        wave = 3e-4 * np.sin(3.0 * rows.q[:, 0] + 0.4)
        along = np.cross([0.0, 0.0, 1.0], rows.position)  # the first joint stands upright
        found.append(replace(rows, position=rows.position + wave[:, None] * along))
    names = ("eccentricity", "unknown_joint_curve", "backlash", "axial_compliance")
    report = find_gap(katana(), found[0], replace(QUICK, effects=names), confirmation=found[1])
    about = {j.evidence.candidate.id: j for j in report.effects}
    assert set(about) == {"eccentricity", "unknown_joint_curve"}
    assert (about["eccentricity"].verdict, about["eccentricity"].claim.said) == ("replicated", "class")
    assert about["eccentricity"].display_name.startswith("error curve of joint 1")
