"""The result of an activation, and the log of activations, as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kilter_client.cli.reports.answer import IN_JSON, LINES, PLACEHOLDER, fit_messages, format_next, suggest_after_today
from kilter_client.cli.terminal.output import (
    is_note_due,
    number,
    print_line,
    print_lines,
    screen_columns,
    show_list,
    show_rows,
)

ONCE = {"compensation_unknown"}  # warnings that hold until somebody does what they ask for


def show_active(server: str, state: str, document: Mapping[str, Any]) -> None:
    """Print that a version is active, what its stream leaves out, and on what it was compared."""
    print_line(f"{document['id']} is {state}.{_describe_gain(document.get('compared'))}")
    if document["not_corrected"]:
        print_line(document["not_corrected"])
    for objection in document.get("objections") or ():
        print_line(f"forced, though: {objection['message']}")
    for warning in document.get("warnings") or ():
        if warning["code"] not in ONCE or is_note_due(server, warning["message"]):
            print_line(f"warning: {warning['message']}")
    _show_preview(document.get("preview"))
    _show_comparison(document["id"], document.get("compared"))
    print_lines(format_next("correct", document["robot"], PLACEHOLDER, "-o", "corrected.csv"))


def _describe_gain(compared: Mapping[str, Any] | None) -> str:
    """Say how large the error is now and was before, on poses that no fit used; nothing where there were none."""
    if not compared:
        return ""
    rival = compared["active"] or compared["registration_only"]
    before = f"{number(rival['mean_mm'], 2)} -> " if rival else ""
    return f" Mean error on {compared['poses']} poses that no fit used: {before}{number(compared['mean_mm'], 2)} mm."


def _show_preview(preview: Mapping[str, Any] | None) -> None:
    """Print what the version does with the robot's poses."""
    if not preview:
        return
    poses = "measured poses" if preview["within"] == "campaigns" else "poses within the joint limits"
    every = "all" if preview["corrected"] == preview["poses"] else f"{preview['corrected']} of"
    refused = sum(preview["refused"].values())
    held = ((preview["damped"], "near a singularity"), (preview["limited"], "held at a limit"), (refused, "refused"))
    said = "".join(f", {count} {words}" for count, words in held if count)
    largest = "" if preview["largest_mm"] is None else f" Largest correction: {number(preview['largest_mm'], 3)} mm."
    print_line(f"Corrects {every} {preview['poses']} {poses}{said}.{largest}")


def _show_comparison(version: str, compared: Mapping[str, Any] | None) -> None:
    if not compared or not compared["active"]:  # else the headline has all of it
        return
    where = ", ".join(compared.get("campaign_names") or compared["campaigns"])
    print_line(
        f"Compared on {compared['poses']} poses ({compared['rows']} rows) that neither was fitted to, of {where}:"
    )
    rivals = (("registration only", compared["registration_only"]), (compared["active_version"], compared["active"]))
    rows = [
        (name, number(rival["mean_mm"]), number(rival["larger_by_mm"], 2), number(rival["margin_mm"], 2))
        for name, rival in rivals
        if rival
    ]
    new = (f"{version} (new)", number(compared["mean_mm"]), "", "")
    show_rows(("model", "mean mm", "new larger by mm", "chance mm"), [*rows, new], numbers=True)


def show_activations(document: Mapping[str, Any]) -> None:
    """Print the log, newest first."""
    rows = [
        (
            str(entry["at"])[:16].replace("T", " "),
            f"forced {entry['action']}" if entry["forced"] else entry["action"],
            entry["version_id"],
            entry["actor"],
            entry["reason"] or ", ".join(objection["code"] for objection in entry["objections"]),
        )
        for entry in document["activations"]
    ]
    show_list(("when", "what", "version", "by", "why"), rows)


def show_today(document: Mapping[str, Any]) -> None:
    """Print how good a robot is today, in the server's words."""
    standing = document["standing"]
    suggested = suggest_after_today(document)
    print_line(f"{standing['words']}. {standing['sentence']}")
    sentences = [one for one in document["sentences"] if one != standing["sentence"]]
    print_lines(fit_messages(sentences, screen_columns(), LINES - 1 - len(suggested), IN_JSON))
    print_lines(suggested)
