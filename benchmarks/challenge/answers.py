"""What the search says of every case, as a person gets it: files uploaded to a server, one search each."""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from benchmarks.challenge.case import TRUTH, Case
from kilter_client import Kilter
from kilter_client.errors import KilterError

KEPT = ("verdict", "sentence", "effects", "gap", "predictive", "adequacy", "warnings")


def answers(wanted: Sequence[Case], path: Path, url: str, token: str) -> list[dict[str, Any]]:
    """Answers to the cases, those in the file ``path`` without another search; each is written as soon as it is there.

    An answer counts for the files that it was given: where one has changed, or the search failed, it is made again.
    """
    known = {one["name"]: one for one in _stored(path)}
    with Kilter(url, token=token) as kilter, path.open("a", encoding="utf-8") as file:
        for case in wanted:
            one = known.get(case.name, {})
            if one.get("given") != given(case) or one["report"] is None:
                known[case.name] = answer(kilter, case)
                file.write(json.dumps(known[case.name]) + "\n")
                file.flush()
            one = known[case.name]
            print(f"{case.name}: {one['error'] or one['report']['sentence']} ({one['seconds']:.1f} s)", file=sys.stderr)
    return [known[case.name] for case in wanted]


def answer(kilter: Kilter, case: Case) -> dict[str, Any]:
    """What the search says of one case, or the error that it ends with."""
    began = time.monotonic()
    record: dict[str, Any] = {"name": case.name, "given": given(case), "report": None, "error": None}
    try:
        report = _searched(kilter, case)
        record["report"] = {name: report.get(name) for name in KEPT}
    except KilterError as error:
        record["error"] = f"{type(error).__name__}: {error}"
    return record | {"seconds": time.monotonic() - began}


def given(case: Case) -> dict[str, str]:
    """SHA-256 of every file of the case but the truth."""
    files = [path for path in sorted(case.folder.iterdir()) if path.is_file() and path.name != TRUTH]
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def _searched(kilter: Kilter, case: Case) -> Any:
    told, robot = case.given(), f"challenge-{hashlib.sha256(case.robot.read_bytes()).hexdigest()[:12]}"
    kilter.add_robot(case.robot, name=robot, **told.robot)
    about = {
        "device": told.device, "payload_kg": told.payload_kg, "payload_com_mm": told.payload_com_mm,
        "temperature_c": told.temperature_c,
    }  # fmt: skip
    sent: dict[str, Any] = {}
    for role, path in (
        ("train", case.campaign),
        *((role, case.perhaps(role)) for role in ("validation", "confirmation")),
    ):
        if path is not None:
            sent[role] = kilter.upload(robot, path, role=role, progress=False, **about)
    return kilter.gap(
        robot, sent["train"], validation=sent.get("validation"), confirmation=sent.get("confirmation", ()),
        progress=False, **told.options,
    )  # fmt: skip


def _stored(path: Path) -> Iterator[dict[str, Any]]:
    if path.is_file():
        for line in path.read_text(encoding="utf-8").splitlines():
            yield json.loads(line)
