"""An identification leaves no more in sealed rows of a real arm than a fit that shares no code with it."""

from pathlib import Path

from tests.core.sealed.score import score


def test_a_humanoids_arm_is_predicted_as_well_as_by_an_independent_fit(shared_data: Path) -> None:
    """In the other sector of joint 1 7 % more was left, as directions that rows told in part were held at nominal."""
    found = list(score(shared_data, "talos"))
    assert len(found) == 5
    assert [one.split for one in found if not one.at_or_below] == []
