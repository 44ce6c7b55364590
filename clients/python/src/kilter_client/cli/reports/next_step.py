"""What to do after an answer: the command to type next, of every command in this one place."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any

from kilter_client import Kilter
from kilter_client.cli.terminal.output import name_ids

Document = Mapping[str, Any]
PLACEHOLDER = "FILE"  # of the person's own


def format_next(*words: str, when: str = "") -> list[str]:
    """Return the line that names a command, its words quoted as a shell needs them, and ``when`` it is next."""
    return [f"Next{when}: kilter {name_ids(shlex.join(words))}"]


def suggest_after_job(kilter: Kilter, job: Document) -> list[str]:
    """Return what to do after a job: with the version that it made or looked at, or about an arm that has moved."""
    result: Document = job.get("result") or {}
    if job["kind"] == "drift" and result:
        if result["verdict"] == "ok":
            return format_next("today", job["robot"])
        return suggest_after_today(kilter.robots.today(job["robot"]))
    if job["kind"] == "plan" and result:
        return format_next("check" if result["purpose"] == "check" else "upload", job["robot"], PLACEHOLDER)
    if job["kind"] == "payload" and result.get("centre_mm"):
        centre = ",".join(f"{value:.0f}" for value in result["centre_mm"])
        load = ["--payload-kg", f"{result['mass_kg']:.3g}", f"--payload-com-mm={centre}"]
        return format_next("upload", job["robot"], PLACEHOLDER, *load, when=", with rows that carry it")
    if result.get("motion") and not result.get("version_id"):  # a log makes a version where it names a start
        weak = any(one["sure"] != "certain" for one in result.get("found") or ())
        when = ", to decide" if weak else ", to see the same in a second log"
        return format_next("plan", "motion", job["robot"], "-o", "motions.csv", when=when)
    return suggest_for_version(kilter.versions.get(result["version_id"])) if result.get("version_id") else []


def suggest_for_version(version: Document) -> list[str]:
    """Return what to do with a version: see how good it is today, look for what it lacks, or activate it.

    What speaks against one says itself what to do.
    """
    if version["active"]:
        return format_next("today", version["robot"])
    if version.get("something_missing"):
        used = [
            _repeat(option, [one["id"] for one in version["campaigns"] if one["use"] == use])
            for option, use in (("--campaign", "train"), ("--validation", "validation"))
        ]
        return format_next("gap", version["robot"], *used[0], *used[1])
    return [] if version.get("objections") else format_next("activate", version["id"])


def suggest_after_upload(kilter: Kilter, robot: str, campaign: str) -> list[str]:
    """Return what to do with a campaign: search in it, on what is held out, or compare the active version with it."""
    others = sorted(kilter.campaigns.list(robot), key=itemgetter("rows"), reverse=True)  # checks have few
    role = next((one["role"] for one in others if one["id"] == campaign), None)
    fitted, held = ([one["id"] for one in others if one["role"] == use] for use in ("train", "validation"))
    if role == "train":
        return format_next("gap", robot, "--campaign", campaign, *_repeat("--validation", held[:1]))
    if kilter.robots.get(robot).get("active_version"):
        return format_next("version", "evaluate", robot, "--campaign", campaign)
    if role == "validation" and fitted:
        return format_next("gap", robot, "--campaign", fitted[0], "--validation", campaign)
    return format_next("upload", robot, PLACEHOLDER)


def suggest_after_today(today: Document) -> list[str]:
    """Return what to do about an arm as it is today: what the server's answer says first, as its page does."""
    steps = today["standing"]["steps"]
    return [f"Next: {name_ids(steps[0]['command'])}"] if steps else []


def _repeat(option: str, values: Sequence[str]) -> list[str]:
    return [word for value in values for word in (option, value)]
