"""Who carries the load of an axis that follows a joint: said by documents and URDFs, and told by the check of a robot."""

from __future__ import annotations

from typing import Any

import pytest

from kilter_core.errors import RobotError
from kilter_service.contract.robots import ChainRobot, UrdfRobot
from kilter_service.robots.check import check
from kilter_service.robots.documents import core_document
from tests.core.palletiser import palletiser, said

URDF = """<robot name="arm">
<link name="base"/><link name="upper"/><link name="bar"/><link name="fore"/>
<joint name="j1" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
 <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="rod" type="revolute"><parent link="upper"/><child link="bar"/><origin xyz="0 0 1"/><axis xyz="0 1 0"/>
 <limit lower="-1" upper="1" effort="1" velocity="1"/><mimic joint="j1" multiplier="-1"/></joint>
<joint name="j2" type="revolute"><parent link="bar"/><child link="fore"/><axis xyz="0 1 0"/>
 <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>"""


def posted(joints: list[dict[str, Any]]) -> UrdfRobot:
    return UrdfRobot.model_validate(
        {"name": "arm", "convention": "urdf", "urdf": URDF, "base_link": "base", "tip_link": "fore", "joints": joints}
    )


@pytest.mark.parametrize(
    ("drive", "words"),
    [
        ("linkage", "carries the load on axis 2 and -1 times that on axis 3"),
        ("controller", "alone"),
        ("series", "alone"),
    ],
)
def test_the_check_says_who_carries_the_load(drive: str, words: str) -> None:
    found = check(ChainRobot.model_validate(said(palletiser(), drive)))
    (sentence,) = found.drives
    assert words in sentence
    assert "Axis 3 follows j2" in sentence
    assert ("counts as moving axis 3" in sentence) == (drive == "controller")
    assert [axis.drive for axis in found.axes] == [None, None, drive, None, None]
    assert not any("does not say who carries" in text for text in found.suspicious)


def test_the_check_says_that_nobody_said() -> None:
    found = check(ChainRobot.model_validate(said(palletiser(), None)))
    assert found.drives == []
    (text,) = [text for text in found.suspicious if "does not say who carries" in text]
    assert "linkage" in text
    assert "Axis 3 follows j2" in text


def test_a_mimic_joint_of_a_urdf_says_it_by_its_name() -> None:
    found = check(posted([{"name": "rod", "drive": "linkage"}]))
    assert "Axis 2 follows j1 (ratio -1) by a linkage" in found.drives[0]
    assert any("does not say who carries" in text for text in check(posted([])).suspicious)


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        ([{"name": "rod", "limits_deg": [-1, 1]}], "only its drive counts"),
        ([{"name": "j2", "drive": "linkage"}], "give it to that axis"),
        ([{"name": "elbow", "drive": "linkage"}], "rod"),
    ],
)
def test_what_cannot_be_said_is_refused(joints: list[dict[str, Any]], words: str) -> None:
    with pytest.raises(RobotError, match=words):
        check(posted(joints))


def test_without_drives_a_urdf_is_what_it_was() -> None:
    document = posted([]).model_dump(mode="json", exclude_none=True)
    assert not any("drive" in element for element in core_document(document).document["elements"])
