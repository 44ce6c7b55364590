"""What is said of rows before anything is fitted: coverage, repeats, noise, and rows that look wrong, of known data."""

from __future__ import annotations

import httpx
import numpy as np
import pytest

from kilter_service.campaigns import looking
from kilter_service.campaigns.facts import facts
from kilter_service.ground.db import Database

from .conftest import Katana

POSES, VISITS, NOISE_MM = 40, 3, 0.02


def measured(katana: Katana) -> dict[str, np.ndarray]:
    """Poses that were visited in rounds, with noise of a known size."""
    one = {name: np.array(values) for name, values in katana.columns(POSES, seed=3, noise_m=0.0).items()}
    rows = {name: np.tile(values, VISITS) for name, values in one.items()}
    random = np.random.default_rng(5)
    for axis in "xyz":
        rows[f"{axis}_mm"] = rows[f"{axis}_mm"] + random.normal(0.0, NOISE_MM, POSES * VISITS)
    return rows


def stored(client: httpx.Client, katana: Katana, rows: dict[str, np.ndarray]) -> str:
    client.post("/v1/robots", json=katana.document).raise_for_status()
    made = client.post(f"/v1/robots/{katana.name}/campaigns", json={"name": "facts"}).raise_for_status().json()
    columns = {name: values.tolist() for name, values in rows.items()}
    client.post(f"/v1/campaigns/{made['id']}/observations", json=columns).raise_for_status()
    return str(made["id"])


def test_repeats_noise_and_coverage_are_those_of_the_data(
    client: httpx.Client, database: Database, katana: Katana
) -> None:
    rows = measured(katana)
    found = facts(looking.load_campaign_rows(database, stored(client, katana, rows)))
    assert (found.rows, found.repeats.poses, found.repeats.visits) == (POSES * VISITS, POSES, POSES * VISITS)
    assert found.repeats.visits_per_pose == (VISITS, VISITS)
    assert found.repeats.between is not None
    assert found.repeats.between * 1e3 == pytest.approx(NOISE_MM, rel=0.2)
    assert found.repeats.freedom == 3 * POSES * (VISITS - 1)
    assert found.doubtful.count == 0
    first = found.joints[0]
    assert (first.low, first.high) == pytest.approx((rows["q1_deg"].min(), rows["q1_deg"].max()))
    assert sum(first.bins) == POSES * VISITS
    assert first.share == pytest.approx((first.high - first.low) / (2 * 169.5))
    assert [one.name for one in found.columns] == list(rows)


def test_rows_that_look_wrong_are_named_and_do_not_count_as_noise(
    client: httpx.Client, database: Database, katana: Katana
) -> None:
    rows = measured(katana)
    rows["x_mm"][16] += 3.0  # row 17: a wrong reading of a repeated pose
    for axis in "xyz":
        rows[f"{axis}_mm"][60] = rows[f"{axis}_mm"][59]  # row 61: the instrument kept its last reading
    found = facts(looking.load_campaign_rows(database, stored(client, katana, rows)))
    named = {one.row: one.why for one in found.doubtful.rows}
    assert set(named) == {17, 61}
    assert "from the other rows of its pose" in named[17]
    assert "to the last digit" in named[61]
    assert found.repeats.between is not None
    assert found.repeats.between * 1e3 == pytest.approx(NOISE_MM, rel=0.25)
    assert {17, 61} <= {row for row, _ in found.places}


def test_two_wild_rows_do_not_count_as_noise_where_every_pose_was_visited_twice(
    client: httpx.Client, database: Database, katana: Katana
) -> None:
    rows = {name: values[: 2 * POSES] for name, values in measured(katana).items()}
    rows["y_mm"][7] += 4.0
    rows["z_mm"][POSES + 20] -= 2.5
    found = facts(looking.load_campaign_rows(database, stored(client, katana, rows)))
    assert found.repeats.between is not None
    assert found.repeats.between * 1e3 == pytest.approx(NOISE_MM, rel=0.25)
    named = {one.row: one.why for one in found.doubtful.rows}
    assert set(named) == {8, POSES + 8, 21, POSES + 21}  # of two that disagree nobody knows which
    assert float(named[8].split()[0]) == pytest.approx(4.0, abs=0.1)  # from the other, not from between them


@pytest.mark.parametrize("apart_mm", [0.0, 3.0])
def test_a_pose_whose_sides_differ_far_more_than_those_of_others_is_named(
    client: httpx.Client, database: Database, katana: Katana, apart_mm: float
) -> None:
    """As by a nest that was missed once; what backlash does to all poses is usual."""
    rows = {name: values[: 2 * POSES] for name, values in measured(katana).items()}
    side = np.repeat([1.0, -1.0], POSES)
    for joint in range(1, 6):
        rows[f"dir{joint}"] = side
    rows["x_mm"] = rows["x_mm"] + 0.1 * side
    rows["y_mm"][POSES + 20] += apart_mm
    found = facts(looking.load_campaign_rows(database, stored(client, katana, rows)))
    assert {one.row for one in found.doubtful.rows} == ({21, POSES + 21} if apart_mm else set())
    assert found.repeats.between is None


def test_a_row_far_from_the_arm_is_named_without_repeats(
    client: httpx.Client, database: Database, katana: Katana
) -> None:
    rows = {name: np.array(values) for name, values in katana.columns(60, seed=1).items()}
    rows["z_mm"][30] += 60.0
    found = facts(looking.load_campaign_rows(database, stored(client, katana, rows)))
    assert [one.row for one in found.doubtful.rows] == [31]
    assert found.repeats.between is None
