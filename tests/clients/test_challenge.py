"""Hidden cases: seals, one search as a user makes it, and a score that is right where the truth is known by hand."""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.challenge import multibody
from benchmarks.challenge.answers import answer
from benchmarks.challenge.case import CLASSES, Case, CaseError, Hidden, Truth, cases
from benchmarks.challenge.page import Scored, figures, page
from kilter_client import Kilter

Floats = NDArray[np.float64]
SALT = "0123456789abcdef"
TWIST: dict[str, Any] = {"physical_class": "joint_twist", "effects": ["link_torsion"], "joints": [3, 4]}


def sealed(folder: Path, truth: str, seal: str | None = None) -> Case:
    """A case whose truth is sealed, by its own hash or by ``seal``."""
    case = folder / "one"
    case.mkdir(parents=True)
    (case / "robot.csv").write_text("")
    (case / "truth.json").write_text(truth)
    digest = seal or hashlib.sha256(truth.encode()).hexdigest()
    (folder / "seals.txt").write_text(f"{digest} *./one/truth.json\n")
    return Case(case)


def document(**hidden: Any) -> str:
    """A truth as its author writes it."""
    return json.dumps({"format": 1, "salt": SALT, "family": "f", "hidden": [TWIST | hidden]})


def test_a_truth_counts_that_was_sealed(tmp_path: Path) -> None:
    truth = sealed(tmp_path, document()).truth()
    assert truth is not None
    assert truth.hidden[0].demanded
    (tmp_path / "one" / "truth.json").write_text(document(joints=[1]))
    with pytest.raises(CaseError, match=r"one/truth\.json is not the truth that was sealed"):
        Case(tmp_path / "one").truth()
    (tmp_path / "seals.txt").unlink()
    with pytest.raises(CaseError, match=r"no seal of one/truth\.json.*sha256sum \*/truth\.json > seals\.txt"):
        Case(tmp_path / "one").truth()


@pytest.mark.parametrize(
    ("hidden", "said"),
    [
        ({"physical_class": "magic"}, "no physical class 'magic'. There are .*joint_curve"),
        ({"effects": ["magic"]}, "no effect 'magic': leave it out"),
        ({"joint": [1]}, r"truth.json: hidden.0.joint: Extra inputs"),
    ],
)
def test_a_truth_that_cannot_be_read_names_the_place(tmp_path: Path, hidden: dict[str, Any], said: str) -> None:
    with pytest.raises(CaseError, match=said):
        sealed(tmp_path, document(**hidden)).truth()


def test_the_how_to_lists_every_class() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "how-to" / "hide-a-case.md").read_text(encoding="utf-8")
    assert {line.split("`")[1] for line in page.splitlines() if line.startswith("| `")} == CLASSES - {"shape"}


def test_a_folder_without_cases_says_where_the_format_is(tmp_path: Path) -> None:
    with pytest.raises(CaseError, match=r"hide-a-case\.md"):
        cases(tmp_path)


def test_the_load_hangs_where_the_truth_says() -> None:
    """Virtual work: what the load adds to a joint is its weight times how far the flange rises as the joint moves."""
    rng = np.random.default_rng(3)
    arm = multibody.Arm(multibody.Nominal.drawn(rng), multibody.clean(rng), rng)
    q, load = rng.uniform(-1.0, 1.0, 6), 4.0

    def told(kg: float, pose: Floats) -> tuple[Floats, float]:
        arm.point(pose, kg)
        return arm.data.qfrc_bias[arm.driven].copy(), float(arm.data.xpos[arm.load, 2])

    added = told(load, q)[0] - told(0.0, q)[0]
    step = 1e-5 * np.eye(6)
    rises = [(told(0.0, q + d)[1] - told(0.0, q - d)[1]) / 2e-5 for d in step]
    assert added == pytest.approx(load * 9.81 * np.array(rises), abs=1e-4)


def test_an_author_s_tools_write_what_is_read(tmp_path: Path) -> None:
    """Cases by MuJoCo, and seals by sha256sum."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.challenge.multibody", str(tmp_path / "cases"), "--n", "2", "--poses", "20"],
        cwd=Path(__file__).resolve().parents[2], env=dict(os.environ), check=True, capture_output=True,
    )  # fmt: skip
    assert done.stderr == b""
    own = (tmp_path / "cases" / "seals.txt").read_text()
    assert [case.truth() is not None for case in cases(tmp_path / "cases")] == [True, True]
    told = subprocess.run(
        ["sh", "-c", "sha256sum */truth.json"], cwd=tmp_path / "cases", capture_output=True, text=True, check=True
    )
    assert told.stdout == own


def effect(said: str, joints: list[int], verdict: str = "confirmed", id_: str = "link_torsion", **more: Any) -> Any:
    """An effect of a result: what the score reads of it."""
    return {
        "id": id_, "joints": joints, "verdict": verdict, "empirical": False, "alias_set": [], "parameters": [],
        "claim": {"said": said, "words": id_}, "physical_class": {"id": "joint_twist"}, **more,
    }  # fmt: skip


def scored(*effects: Any, hidden: tuple[dict[str, Any], ...] = (TWIST,)) -> Scored:
    """A case with what was answered."""
    report = {"effects": list(effects), "gap": None, "predictive": None}
    truth = Truth(format=1, salt=SALT, family="f", hidden=[Hidden(**one) for one in hidden])
    return Scored("one", truth, {"report": report, "seconds": 1.0, "error": None})


@pytest.mark.parametrize(
    ("said", "wrong", "exact"),
    [
        (effect("member", [4]), 0, True),  # the link between joints 3 and 4
        (effect("class", [4], id_="axial_compliance"), 0, False),  # its class, by the shape of another member
        (effect("member", [4], id_="axial_compliance"), 1, False),  # the gear is not what was hidden
        (effect("member", [4], "provisional", "axial_compliance"), 0, False),  # and this is no claim
        (effect("class", [5]), 1, False),  # another joint
        (effect("class", [4], id_="eccentricity", physical_class={"id": "joint_curve"}), 1, False),
        (effect("one_of", [2], id_="axial_compliance", alias_set=[{"id": "link_torsion", "joints": [3]}]), 0, False),
        (effect("one_of", [2], id_="axial_compliance", alias_set=[{"id": "link_torsion", "joints": [6]}]), 1, False),
    ],
)
def test_a_claim_is_right_of_what_was_hidden_and_no_more(said: Any, wrong: int, exact: bool) -> None:
    one = scored(said)
    assert (len(one.wrong()), one.exact()) == (wrong, exact)
    assert len(scored(said, hidden=()).wrong()) == (said["verdict"] != "provisional")


def test_the_page_has_bounds_families_and_every_wrong_claim() -> None:
    text = page([scored(effect("member", [5])), scored(effect("member", [3]))], ["two"])
    assert (
        "| confirmed outside the true class, or under a wrong name | ≤ 0.5 % | 50.0% (1) | 2 | 1.3% – 98.7% |" in text
    )
    assert "| f | 2 | 1 | 1 | 1 | 1.3% – 98.7% |" in text
    assert "said *link_torsion* (confirmed); hidden was joint_twist [3, 4]" in text
    assert "Answered and still sealed: two." in text


def test_a_case_is_searched_as_a_user_would(kilter: Kilter, tmp_path: Path) -> None:
    """A gear that gives way, settled by MuJoCo: found at its joint, with its size."""
    multibody.write(tmp_path / "one", "compliance", 100_001)
    found = Scored(
        "one",
        Truth.model_validate_json((tmp_path / "one" / "truth.json").read_text()),
        answer(kilter, Case(tmp_path / "one")),
    )
    assert found.answered, found.answer["error"]
    assert found.exact()
    assert not found.wrong()
    shares = {figure.title: figure for figure in figures([found])}
    assert shares["95 % intervals that hold the true size"].k == 1
    assert float(shares["gap closed on held-out rows, pooled"].value or 0.0) > 90.0
