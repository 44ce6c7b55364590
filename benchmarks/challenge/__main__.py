"""Run and score cases that somebody else hid: ``python -m benchmarks.challenge DIR`` (docs/how-to/hide-a-case.md)."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

from benchmarks.challenge.answers import answers
from benchmarks.challenge.case import CaseError, cases
from benchmarks.challenge.page import Scored, figures, page
from kilter_client.requests.connection import local_server

ANSWERS = "answers.jsonl"


def main() -> int:
    """Search every case on a server of its own, write the answers, and score those whose truth is opened."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.challenge", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of cases")
    parser.add_argument("--json", action="store_true", help="print the figures as JSON instead of the page")
    asked = parser.parse_args()
    try:
        print(run(asked.folder, asked.json))
    except CaseError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


def run(folder: Path, as_json: bool = False) -> str:
    """Answers first, truths afterwards: nothing of a truth is read before every case has been answered.

    Raises:
        CaseError: a case that cannot be read, or a truth that is not the sealed one.

    """
    wanted = cases(folder)
    with tempfile.TemporaryDirectory() as data, local_server(Path(data)) as server:
        token = (server.data / "token").read_text(encoding="ascii").strip()
        said = answers(wanted, folder / ANSWERS, server.url, token)
    opened = [(case, truth, one) for case, one in zip(wanted, said, strict=True) if (truth := case.truth()) is not None]
    scored = [Scored(case.name, truth, one) for case, truth, one in opened]
    sealed = [case.name for case in wanted if case.name not in {s.name for s in scored}]
    if as_json:
        return json.dumps(
            {"scored": len(scored), "sealed": sealed, "figures": [asdict(f) for f in figures(scored)] if scored else []}
        )
    (folder / "score.md").write_text(text := page(scored, sealed), encoding="utf-8")
    return text


if __name__ == "__main__":
    sys.exit(main())
