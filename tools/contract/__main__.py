"""Write everything that says again what the contract or the core's effects say, or check that it is up to date."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from kilter_core.effects import EFFECTS, Effect
from kilter_core.motion.effects import MOTION_EFFECTS, MotionEffect
from tools.contract.client import LISTS, client_files
from tools.contract.interface import SNAPSHOT
from tools.contract.lists import describe_option, options_data

JOINTS = next(f.metadata["text"] for f in fields(Effect) if f.name == "joints")


def effects_data() -> str:
    """Return the data that the contract makes its models of: JSON, an option a line."""
    lines = [*(_lines(kind) for kind in EFFECTS.values()), *(_line_of_torques(effect) for effect in MOTION_EFFECTS)]
    return "[\n" + ",\n".join(lines) + "\n]\n"


def _line_of_torques(effect: MotionEffect) -> str:
    return _json(
        {
            "id": effect.id,
            "model": f"{effect.id.title().replace('_', '')}Effect",
            "summary": f"{effect.label[0].upper()}{effect.label[1:]}, in logs of torques.",
            "at_joints": True,
            "joints": JOINTS,
            "options": [],
        }
    )


def _lines(kind: type[Effect]) -> str:
    said = {
        "id": kind.id,
        "model": f"{kind.__name__}Effect",
        "summary": f"{kind.summary[0].upper()}{kind.summary[1:]}.",
        "at_joints": kind.at_joints,
        "joints": JOINTS if kind.at_joints else "Null: the effect does not act at joints.",
    }
    declared = (describe_option(one, one.name in kind.counted) for one in fields(kind) if one.name != "joints")
    options = ",".join(f"\n  {_json(one)}" for one in declared)
    return f'{_json(said)[:-1]}, "options": [{options}]}}'


def _json(said: dict[str, Any]) -> str:
    return json.dumps(said, ensure_ascii=False)


REPOSITORY = Path(__file__).resolve().parents[2]
# Pages with a few tables that are made, and pages that are made of their text and of all their tables.
WITH_TABLES = ("docs/reference/effects.md", "docs/how-to/from-your-files.md")
MADE_PAGES = ("docs/reference/cli.md", "docs/reference/job-options.md", "docs/reference/routes.md")
MATLAB = ("identify", "gap", "evaluate", "plan")


def modules() -> dict[Path, str]:
    """Return what the contract itself takes from the core as it should be."""
    texts = {
        "service/kilter_service/contract/effects.json": effects_data(),
        "service/kilter_service/contract/options.json": options_data(),
    }
    return {REPOSITORY / name: text for name, text in texts.items()}


def interface() -> dict[Path, str]:
    """Return the snapshot of the interface as it should be."""
    from tools.contract.lists import served_interface_text  # imports the modules, which must stand

    return {SNAPSHOT: served_interface_text()}


def lists() -> dict[Path, str]:
    """Return what the client lists without a server as it should be."""
    from tools.contract.lists import lists_text

    return {LISTS: lists_text()}


def tables() -> dict[Path, str]:
    """Return what else repeats the contract in files of the repository as it should be."""
    from tools.contract.tables import with_help, with_tables

    texts = {page: with_tables(read(page)) for page in WITH_TABLES}
    texts |= {
        f"clients/matlab/+kilter/{kind}.m": with_help(kind, read(f"clients/matlab/+kilter/{kind}.m")) for kind in MATLAB
    }
    return {REPOSITORY / name: text for name, text in texts.items()}


def pages() -> dict[Path, str]:
    """Return the pages of the reference that are made of a text and of tables as they should be."""
    from tools.contract.tables import made_page

    return {REPOSITORY / page: made_page(f"{Path(page).name}.in", read(f"{page}.in")) for page in MADE_PAGES}


def library() -> dict[Path, str]:
    """Return the reference of the Python library as it should be; a process of its own sees the types just written."""
    done = subprocess.run(
        [sys.executable, "-m", "tools.contract.library"], capture_output=True, text=True, check=True, cwd=REPOSITORY
    )
    return {REPOSITORY / "docs/reference" / name: text for name, text in json.loads(done.stdout).items()}


# In the order of need. What is made where it is needed, git does not hold; the rest it does, for a reviewer to see its change.
ALL = (modules, interface, lists, client_files, tables, pages, library)
MADE = (client_files, pages, library)


def stale(files: Mapping[Path, str], check: bool) -> bool:
    """Write, or name with ``check``, what is not up to date; whether anything was."""
    old = [path for path, text in files.items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    for path in old:
        if check:
            print(f"{path.relative_to(REPOSITORY)} is not what the contract says: run make contract.", file=sys.stderr)
        else:
            path.write_text(files[path], encoding="utf-8")
    return bool(old)


def read(name: str) -> str:
    """Return the text of a file of the repository."""
    return (REPOSITORY / name).read_text(encoding="utf-8")


def main() -> int:
    """Write, or compare with --check; 1 when something is not up to date."""
    parser = argparse.ArgumentParser(prog="python -m tools.contract", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing, say what is not up to date")
    parser.add_argument("--made", action="store_true", help="only what git does not hold")
    given = parser.parse_args()
    if not (given.made or given.check) and stale(modules(), check=False):
        # What is imported is the contract before.
        os.execv(sys.executable, [sys.executable, "-m", "tools.contract"])  # noqa: S606 (itself)
    found = [stale(files(), given.check) for files in (MADE if given.made else ALL)]
    return 1 if given.check and any(found) else 0


if __name__ == "__main__":
    sys.exit(main())
