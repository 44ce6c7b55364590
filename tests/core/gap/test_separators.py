"""What names a member of a physical class: two loads, both sides, a temperature beside time; else the class is claimed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from kilter_core.effects import EFFECTS
from kilter_core.effects.physical import Separator
from kilter_core.gap import GapOptions, find_gap
from kilter_core.gap.evidence.claim import Claim
from kilter_core.gap.evidence.separators import Separated
from kilter_core.gap.evidence.similarity.similarity import Alias
from kilter_core.gap.report.report import effect_row
from kilter_core.gap.search.candidates import FAMILY, Candidate, build_library
from kilter_core.observations import Observations
from tests.core.gap.simulated import Hidden, campaign, katana

QUICK = GapOptions(resamples=20, permutations=5, bootstraps=499, next_poses=0)


def said(rows: Observations, *effects: str) -> dict[str, Any]:
    report = find_gap(katana(), rows, replace(QUICK, effects=effects))
    (effect,) = (effect_row(j, report.library, report.misfit) for j in report.effects)
    return effect


def asked(effect: dict[str, Any]) -> dict[str, bool]:
    return {e["name"]: e["met"] for e in effect["claim"]["evidence"]}


COMPLIANCE: Hidden = ("axial_compliance", (1,), (4e-4,))
LOADED = ("axial_compliance", "backlash", "encoder_scale")


def test_a_compliance_is_named_where_its_share_of_a_second_load_is_seen() -> None:
    effect = said(campaign(katana(), [COMPLIANCE], seed=1, loads=(0.0, 1.0)), *LOADED)
    assert (effect["id"], effect["claim"]["said"], asked(effect)) == ("axial_compliance", "member", {"loads": True})
    assert effect["claim"]["words"] == "axial_compliance j2"
    assert {"link_torsion", "axial_compliance"} <= set(effect["physical_class"]["members"])
    assert effect["verdict"] == "confirmed"


def test_with_one_load_it_is_a_twist_about_its_axis() -> None:
    effect = said(campaign(katana(), [COMPLIANCE], seed=1, loads=(1.0,)), *LOADED)
    assert (effect["id"], effect["claim"]["said"], asked(effect)) == ("axial_compliance", "class", {"loads": False})
    assert effect["class"] == "twist about the axis of joint 2 under load, in the shape of axial compliance"
    assert effect["verdict"] == "class_confirmed"


def test_what_follows_the_posture_and_not_the_load_is_no_compliance() -> None:
    """The same arm errs as if no payload hung on it: a spring or a hose, not the gear."""
    rows = campaign(katana(), [COMPLIANCE], seed=1, loads=(0.0,), poses=90)
    lied = replace(rows, payload_kg=np.random.default_rng(5).choice([0.0, 1.0], 90)[rows.pose_id])
    report = find_gap(katana(), lied, replace(QUICK, effects=("axial_compliance", "backlash")))
    found = [effect_row(j, report.library, report.misfit) for j in report.effects]
    assert found
    assert all(e["claim"]["said"] == "class" and e["verdict"] != "confirmed" for e in found)


def test_a_temperature_that_goes_along_with_time_names_nothing() -> None:
    warm = [("zero_thermal", (2,), (1e-4,))]
    free = said(campaign(katana(), warm, seed=4), "zero_thermal", "backlash")
    assert (free["claim"]["said"], asked(free), free["verdict"]) == ("member", {"temperature": True}, "confirmed")
    rows = campaign(katana(), warm, seed=4)
    assert rows.temperature_c is not None
    together = said(replace(rows, t=600.0 * (rows.temperature_c - 20.0)), "zero_thermal", "backlash")
    assert (together["id"], asked(together)) == ("zero_thermal", {"temperature": False})
    assert together["class"] is not None
    assert "whatever went with it" in together["class"]
    assert together["verdict"] == "class_confirmed"


def test_a_sentence_names_the_nearest_and_counts_the_others() -> None:
    candidates = build_library(katana(), campaign(katana(), seed=2)).candidates
    chosen = next(c for c in candidates if c.id == "eccentricity")
    rivals = [Alias(k, c, 0.0, 1.0, 0.5) for k, c in enumerate(candidates) if c.id in ("backlash", "zero_thermal")]
    assert len(rivals) > 5
    for evidence, end in (
        ((), " others (these data cannot tell)"),
        ((Separated(Separator.TURN, False, 0.4),), " others"),
    ):
        claim = Claim.from_evidence(chosen, katana(), rivals, evidence, settled=True)
        assert claim.words.endswith(end)
        assert claim.words.count(" or ") == 3
    assert Claim.from_evidence(chosen, katana(), rivals[:3], (), settled=True).words.count(" or ") == 3


def test_what_everything_does_as_well_has_no_name() -> None:
    """A headline called "twist about the axis of joint 6 under load" what 111 others did as well."""
    candidates = build_library(katana(), campaign(katana(), seed=2)).candidates
    chosen = next(c for c in candidates if c.id == "axial_compliance")
    rivals = [Alias(k, c, 0.0, 0.1, 0.5) for k, c in enumerate(candidates) if not c.empirical and c is not chosen]
    claim = Claim.from_evidence(chosen, katana(), rivals, (), settled=False)
    assert claim.said == "class"
    assert claim.words.startswith("an effect that these data cannot name (axial_compliance j1 or ")
    assert claim.words.endswith(" others do as well)")


def test_no_more_joints_are_claimed_than_the_halves_bear_out() -> None:
    """Both halves named an error of joint 5 alone, and "smooth error of joints 1, 3, 5" was confirmed."""
    candidates = build_library(katana(), campaign(katana(), seed=2)).candidates
    family = next(c for c in candidates if c.id == "encoder_scale" and c.joints == (0, 1, 2, 3, 4))
    curve = next(c for c in candidates if c.id == "unknown_smooth_curve")
    class_ = [Alias(0, curve, 0.0, 1.0, 0.5, "smooth error of joints 1, 2, 3, 4, 5")]
    for rivals in (class_, []):
        claim = Claim.from_evidence(family, katana(), rivals, (), False, (4,))
        assert claim.words.startswith("smooth error of joint 5, likely of joints 1, 2, 3, 4 too")
        assert claim.to_document()["claim"]["joints"] == [5]
        assert claim.to_document()["physical_class"]["label"] == claim.words
    whole = Claim.from_evidence(family, katana(), class_, (), False)
    assert (whole.words, whole.joints) == ("smooth error of joints 1, 2, 3, 4, 5", (0, 1, 2, 3, 4))


def test_a_family_of_which_some_joints_make_a_turn_is_claimed_at_all_of_them() -> None:
    """The eccentricity of joint 7, which turned, was lost in "smooth error of joints 2, 4"."""
    candidates = build_library(katana(), campaign(katana(), seed=2)).candidates
    family = next(c for c in candidates if c.id == "eccentricity" and c.joints == (0, 1, 2, 3, 4))
    curves = [c for c in candidates if c.id == "unknown_smooth_curve" and c.joints in ((0,), (1,))]
    rivals = [Alias(k, c, 0.0, 1.0, 0.5, "smooth error of joints 1, 2") for k, c in enumerate(curves)]
    claim = Claim.from_evidence(family, katana(), rivals, (), False)
    assert claim.words == "error curve of joints 1, 2, 3, 4, 5, in the shape of eccentricity"


def test_the_class_of_prismatic_and_revolute_joints_is_that_of_those_claimed() -> None:
    """An error of joint 5, which rotates, was called its scale, since joint 1 of the family slides."""
    arm = katana()
    robot = replace(arm, joints=(replace(arm.joints[0], kind="prismatic"), *arm.joints[1:]))
    effects = tuple(EFFECTS["encoder_scale"].from_options(joints=(j,)) for j in (0, 4))
    family = Candidate("encoder_scale", (0, 4), (0, 1), FAMILY, effects=effects)
    words = {borne: Claim.from_evidence(family, robot, [], (), False, borne).words for borne in ((0,), (4,), None)}
    assert words[(0,)].startswith("scale of joint 1, likely of joint 5 too")
    assert words[(4,)] == "smooth error of joint 5, likely of joint 1 too"
    assert words[None] == "smooth error of joints 1, 5"
