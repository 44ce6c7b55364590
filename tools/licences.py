"""Licences of what Kilter needs at run time: ``python -m tools.licences [--check]`` writes docs/reference/licences.md.

Follows the requirements of the four distributions through the packages that are installed. A licence under the GPL is
refused; one under the LGPL must be stated here with the reason it is taken.
"""

from __future__ import annotations

import importlib.metadata as metadata
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from packaging.requirements import Requirement

PAGE = Path(__file__).resolve().parent.parent / "docs" / "reference" / "licences.md"
OURS = ("kilter-core", "kilter-files", "kilter-client", "kilter")
EXTRAS: Mapping[str, tuple[str, ...]] = {
    "kilter-files": ("camera", "formats", "meshes", "sheet", "tags"),
    "kilter-client": ("camera", "files", "meshes", "notebook", "plots", "sheet", "stream", "tags", "usd"),
    "kilter": ("cluster", "files", "pdf", "postgresql", "tracing", "usd"),
}
# Packages that name no licence in a form that a program reads: read in their own licence files.
READ_BY_HAND = {
    "pyphen": "MPL-1.1",  # or the GPL, or the LGPL: whoever uses it chooses
    "reportlab": "BSD-3-Clause",
}
LESSER_GPL_TAKEN = {
    "psycopg": "the driver of PostgreSQL, with the extra `postgresql` only; used unchanged, it may be exchanged.",
    "psycopg-binary": "the compiled part of psycopg.",
    "nptdms": "reads TDMS files, with the extra `formats` only; used unchanged as a library, it may be exchanged.",
}
HEAD = """# Licences

What Kilter needs at run time, by distribution, with the licence that each package states. `python -m tools.licences`
writes this page from the installed packages, `make check` compares it. Nothing under the GPL is needed; what only an
extra needs is marked.

"""
NORMAL = (
    (r"^MIT( License)?$", "MIT"),
    (r"^3-Clause BSD License$", "BSD-3-Clause"),
    (r"^(BSD|New BSD|3-Clause BSD|BSD License)$", "BSD"),
    (r"^(Apache( Software)? License.*|Apache 2.0|Apache License 2.0)$", "Apache-2.0"),
    (r"^ISC License.*$", "ISC"),
    (r"^(PSFL|PSF|Python Software Foundation License)$", "PSF-2.0"),
    (r"^Mozilla Public License 2.0.*$", "MPL-2.0"),
    (r"^Eclipse Public License 2.0.*$", "EPL-2.0"),
)


def canonical(name: str) -> str:
    """Name of a package as indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def needed(name: str, extras: frozenset[str] = frozenset()) -> Iterator[tuple[str, frozenset[str]]]:
    """Direct requirements of an installed package on this platform, with the extras asked of them."""
    for line in metadata.distribution(name).requires or []:
        wanted = Requirement(line)
        if wanted.marker is None or any(wanted.marker.evaluate({"extra": extra}) for extra in (*extras, "")):
            yield canonical(wanted.name), frozenset(wanted.extras)


def closure(name: str, extras: frozenset[str] = frozenset()) -> set[str]:
    """All that a distribution needs, itself and our other distributions left out."""
    seen: set[tuple[str, frozenset[str]]] = set()
    waiting = [(name, extras)]
    while waiting:
        one = waiting.pop()
        if one not in seen:
            seen.add(one)
            waiting += needed(*one)
    return {package for package, _ in seen} - set(OURS)


def licence_of(name: str) -> str:
    """Licence that an installed package states, in the words of SPDX where it can be told."""
    about = metadata.distribution(name).metadata
    stated = _field(about, "License-Expression") or READ_BY_HAND.get(name)
    if stated:
        return stated
    classified = [
        line.rpartition("::")[2].strip() for line in about.get_all("Classifier") or [] if line.startswith("License ::")
    ]
    given = _field(about, "License")
    words = [given] if given and "\n" not in given and len(given) < 60 else classified
    return " OR ".join(_normal(word) for word in words) or "not stated"


def _field(about: metadata.PackageMetadata, name: str) -> str:
    return str((about.get_all(name) or [""])[0]).strip()


def _normal(words: str) -> str:
    return next((short for pattern, short in NORMAL if re.match(pattern, words)), words)


def refused(licences: Mapping[str, str]) -> list[str]:
    """What may not be needed: the GPL, the LGPL without a reason, and licences that nobody could read."""
    wrong = []
    for name, licence in sorted(licences.items()):
        lesser = re.search(r"LGPL|Lesser", licence)
        if not lesser and re.search(r"\bA?GPL|General Public", licence):
            wrong.append(f"{name} is under {licence}: nothing under the GPL may be needed at run time.")
        elif lesser and name not in LESSER_GPL_TAKEN:
            wrong.append(f"{name} is under {licence}: state the reason in tools/licences.py, or leave it out.")
        elif licence == "not stated":
            wrong.append(f"{name} states no licence: read its licence file and write it into READ_BY_HAND.")
    return wrong


def page(licences: Mapping[str, str]) -> str:
    """The page's text."""
    parts = [HEAD]
    for ours in OURS:
        plain = closure(ours)
        with_extras = closure(ours, frozenset(EXTRAS.get(ours, ())))
        rows = [f"| `{name}` | {licences[name]} | {'' if name in plain else 'extra'} |" for name in sorted(with_extras)]
        parts.append(f"## {ours}\n| package | licence | needed |\n|---|---|---|\n" + "\n".join(rows) + "\n\n")
    parts.append("## Under the LGPL\n")
    parts += [f"- `{name}`: {why}\n" for name, why in LESSER_GPL_TAKEN.items()]
    return "".join(parts)


def main(arguments: list[str]) -> int:
    """Write the page, or say with ``--check`` what is wrong."""
    names = set[str]().union(*(closure(ours, frozenset(EXTRAS.get(ours, ()))) for ours in OURS))
    licences = {name: licence_of(name) for name in names}
    wrong = refused(licences)
    text = page(licences)
    if "--check" in arguments:
        # Other versions of Python need some packages more or less: what is needed here must stand on the page.
        there = set(PAGE.read_text(encoding="utf-8").splitlines())
        wrong += [f"docs/reference/licences.md lacks {line}: run `python -m tools.licences`." for line in text.splitlines()
                  if line.startswith("| `") and line not in there]  # fmt: skip
    else:
        PAGE.write_text(text, encoding="utf-8")
    for line in wrong:
        print(line, file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
