"""Files in a script: how one is read, the draft of a map, points of a preset, a dry run, and the version that comes out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import kilter
from kilter_client import Kilter, UsageError, connect

Write = Callable[..., Path]


@pytest.fixture
def k(server: Path) -> Iterator[Kilter]:
    with connect() as client:
        yield client


def lab_table(path: Path, campaign: Path) -> Path:
    """The rows of a campaign as a lab writes them: names of its own, semicolons, decimal commas."""
    rows = [line.split(",") for line in campaign.read_text().splitlines()[1:]]
    head = ";".join([*(f"A{k} [deg]" for k in range(1, 6)), "X [mm]", "Y [mm]", "Z [mm]"])
    path.write_text("\n".join([head, *(";".join(row).replace(".", ",") for row in rows)]) + "\n")
    return path


def test_from_an_unknown_file_to_a_version(k: Kilter, robot: str, write_campaign: Write, tmp_path: Path) -> None:
    campaign = write_campaign(40)
    lab = lab_table(tmp_path / "lab.csv", campaign)
    seen = kilter.inspect(lab)
    assert (seen["kind"], seen["rows"], seen["ready"]) == ("table", 40, False)
    drafted = kilter.draft(lab)
    assert (drafted.open, drafted.unused) == ([], [])
    drafted.save(tmp_path / "map.toml")
    with pytest.raises(UsageError, match="is there already"):
        drafted.save(tmp_path / "map.toml")

    tried = k.dry_run(robot, lab, column_map=tmp_path / "map.toml", payload_kg=0.5)
    assert tried.ok
    assert (tried.rows, tried.refused, tried.not_checked) == (40, (), "")
    assert [one["name"] for one in tried.ranges][:2] == ["q1_deg", "q2_deg"]
    assert tried.loads == {"campaign_payload_kg": 0.5}
    assert k.campaigns.list(robot) == []  # nothing is stored
    assert k.upload(robot, lab, column_map=tmp_path / "map.toml").rows == 40

    found = k.identify(robot, "latest", level=1)
    assert found.version_id == k.versions(robot)[0].version_id == k.version(found).version_id
    assert k.versions(robot)[0].id == found.version_id


def test_a_dry_run_names_what_would_be_refused(k: Kilter, robot: str, write_campaign: Write, tmp_path: Path) -> None:
    rows = write_campaign(12).read_text().splitlines()
    cells = rows[3].split(",")
    bad = tmp_path / "bad.csv"
    bad.write_text("\n".join([*rows[:3], ",".join(["999.0", *cells[1:]]), *rows[4:]]) + "\n")
    tried = k.dry_run(robot, bad)
    assert not tried.ok
    assert tried.refused == (
        "q1_deg is outside the limits -169.5 to 169.5 deg of j1 in 1 rows (row 3), by up to 830 deg",
    )
    columns = {name: [float(row.split(",")[i]) for row in rows[1:]] for i, name in enumerate(rows[0].split(","))}
    assert k.dry_run(robot, columns).ok


def test_a_dry_run_without_a_robot_says_what_it_did_not_check(k: Kilter, write_campaign: Write) -> None:
    tried = k.dry_run("nobody", write_campaign(12))
    assert tried.ok
    assert tried.not_checked.startswith("joints and their limits, and whether the rows belong to the robot")


def test_points_of_a_preset_with_their_joints(k: Kilter, robot: str, write_campaign: Write, tmp_path: Path) -> None:
    rows = [line.split(",") for line in write_campaign(12).read_text().splitlines()]
    joints, points = tmp_path / "joints.csv", tmp_path / "points.txt"
    joints.write_text("\n".join(",".join(row[:5]) for row in rows) + "\n")
    points.write_text(
        "\n".join(["Name X Y Z", *(f"P{i} {' '.join(row[5:])}" for i, row in enumerate(rows[1:]))]) + "\n"
    )
    assert k.upload(robot, points, preset="polyworks", joints=joints).rows == 12
    assert k.campaigns.list(robot)[0]["device"] == "polyworks"
    with pytest.raises(UsageError, match="preset= nikon: is not one of generic, leica"):
        k.upload(robot, points, preset="nikon", joints=joints)
    with pytest.raises(UsageError, match="preset= belongs to a file"):
        k.upload(robot, {"q1_deg": [1.0]}, preset="leica")
    with pytest.raises(UsageError, match="without a column map"):
        k.upload(robot, points, preset="leica", column_map=joints)
