"""`kilter robot fleet`, and the same from the library, against a real server with its worker."""

from __future__ import annotations

import asyncio
import json

import pytest

from kilter_client import Kilter, NotFoundError, connect_async
from kilter_client.cli import run
from tests.clients.conftest import WriteCampaign


def test_a_fleet_from_the_command_line(
    kilter: Kilter, robot: str, write_campaign: WriteCampaign, capsys: pytest.CaptureFixture[str]
) -> None:
    bare = f"{robot}-bare"
    kilter.robots.add({"name": bare, "convention": "preset", "preset": "katana450-chapter4"})
    assert run(["upload", robot, str(write_campaign(60)), "--name", "rows"]) == 0
    capsys.readouterr()
    asked = ["fleet", "identify", robot, bare, "--level", "1", "--name", "autumn"]
    assert run([*asked, "--json"]) == 1  # one of them has no version
    done = json.loads(capsys.readouterr().out)
    assert done["counts"]["succeeded"] == done["counts"]["refused"] == 1

    assert run(["fleet", "show"]) == 0  # the newest
    shown = capsys.readouterr()
    said = " ".join((shown.out + shown.err).split())
    (version,) = kilter.versions.list(robot)
    for words in (
        robot,
        f"{robot} v{version['number']}",
        "refused",
        "no campaign",
        "1 succeeded, 1 refused",
        "Nothing was activated",
    ):
        assert words in said, words
    assert run(["fleet"]) == 0
    listed = " ".join(capsys.readouterr().out.split())
    for words in (done["id"], "autumn", "succeeded", "2 of 2 robots"):
        assert words in listed, words
    assert run(["fleet", "watch", done["id"]]) == 1
    assert run(["fleet", "cancel", done["id"]]) == 1
    assert "nothing is left to cancel" in capsys.readouterr().err


def test_the_campaign_of_a_robot_is_given_with_its_name(
    kilter: Kilter, robot: str, write_campaign: WriteCampaign, capsys: pytest.CaptureFixture[str]
) -> None:
    campaigns = [kilter.campaigns.add(robot, name)["id"] for name in ("first", "second")]
    for seed, campaign in enumerate(campaigns):
        kilter.campaigns.upload(campaign, write_campaign(60, f"{seed}.csv", seed))
    given = ["-c", f"{robot}={campaigns[1]}", "-v", "0.3", "--option", "seed=4", "--level", "1"]
    assert run(["fleet", "identify", robot, *given, "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["report"]
    assert (row["campaigns"], row["validation"]) == ([campaigns[1]], 0.3)
    assert kilter.jobs.get(row["job_id"])["options"] == {"level": 1, "seed": 4}
    assert run(["fleet", "identify", robot, "-c", campaigns[1]]) == 2
    assert "give ROBOT=ID" in " ".join(capsys.readouterr().err.split())


def test_a_fleet_from_the_library(kilter: Kilter, robot: str, write_campaign: WriteCampaign) -> None:
    campaign = kilter.campaigns.add(robot, "rows")["id"]
    kilter.campaigns.upload(campaign, write_campaign(60))
    told: list[str] = []
    queued = kilter.identify_fleet([robot], options={"level": 1})
    assert kilter.fleet_jobs(1)[0]["id"] == queued["id"]
    done = kilter.wait_for_fleet(queued["id"], progress=lambda _, stage: told.append(stage))
    assert told[-1] == "1 of 1 robots"
    assert done["report"][0]["held_out_after_mm"] > 0
    with pytest.raises(NotFoundError):
        kilter.fleet_job("flt_0")

    async def main() -> str:
        async with connect_async() as k:
            again = await k.identify_fleet([robot], options={"level": 1})
            return str((await k.wait_for_fleet(again["id"]))["state"])

    assert asyncio.run(main()) == "succeeded"
