"""Rows of an arm of servos against a real server: those of another calibration are those of another arm."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from kilter_client import Kilter
from kilter_client.cli.files.calibrated_rows import note_of, refuse_other_calibration
from kilter_client.errors import FileError

FIRST, SECOND = "a1" * 32, "b2" * 32


@pytest.fixture
def kilter(server: Path) -> Iterator[Kilter]:
    with Kilter() as connected:
        yield connected


def test_a_new_calibration_is_refused_until_the_old_campaign_is_out_of_use(kilter: Kilter, robot: str) -> None:
    kilter.campaigns.add(robot, "by hand", notes="measured by hand")
    kilter.campaigns.add(robot, "before", notes=f"monday. {note_of(FIRST)}")
    refuse_other_calibration(robot, Path("set"), FIRST)
    with pytest.raises(
        FileError, match=r"calibration b2b2b2b2b2b2, campaign 'before' of .* with a1a1a1a1a1a1"
    ) as caught:
        refuse_other_calibration(robot, Path("set"), SECOND)
    assert caught.value.code == "calibration_differs"
    assert "Add a robot for it, or retire the campaign." in caught.value.detail
    old = next(one for one in kilter.campaigns.list(robot) if one["name"] == "before")
    kilter.retire(old["id"], kind="campaign")
    refuse_other_calibration(robot, Path("set"), SECOND)
