"""Print the oldest version of every dependency that the distributions allow, as constraints for pip.

``python -m tools.oldest_versions > FILE``. What these need themselves is left to pip.
"""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
FOLDERS = (".", "core", "clients/files", "clients/python")
BOUND = re.compile(r"(?P<name>[A-Za-z0-9_.-]+)(?:\[[^]]*\])?>=(?P<version>[0-9.]+)")


def oldest() -> dict[str, str]:
    """Return the lower bound of each dependency by its name."""
    found: dict[str, str] = {}
    for folder in FOLDERS:
        project = tomllib.loads((REPOSITORY / folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        extras = project.get("optional-dependencies", {})
        for text in project["dependencies"] + [one for name, more in extras.items() if name != "dev" for one in more]:
            if bound := BOUND.match(text):
                found[bound["name"].lower()] = bound["version"]
    return found


if __name__ == "__main__":
    print("\n".join(f"{name}=={version}" for name, version in sorted(oldest().items())))
