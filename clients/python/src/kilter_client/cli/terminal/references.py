"""References on the command line: the command says what they stand for before it uses them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.terminal.output import note
from kilter_client.errors import ApiError
from kilter_client.resources.references import Kind, is_full

SAID = ("name", "number")  # of references that say by themselves what they stand for

OfRobot = Annotated[
    str | None,
    typer.Option("--robot", metavar="ROBOT", help="Its robot, where `latest` or a name is ambiguous."),
]


def resolve_reference(
    kilter: Kilter, kind: Kind, reference: str, robot: str | None, as_json: bool, option: str = ""
) -> str:
    """Return the id that a reference stands for, and say it; a full id is taken as it is.

    ``option`` is where it was typed; a refusal begins with it.
    """
    found, sentence = looked_up(kilter, kind, reference, robot, option)
    if sentence:
        note(sentence, as_json)
    return found


def looked_up(
    kilter: Kilter, kind: Kind, reference: str, robot: str | None, option: str = ""
) -> tuple[str, str | None]:
    """Return the id that a reference stands for, and the sentence that says so; None for a full id."""
    if is_full(kind, reference):
        return reference, None
    try:
        found = kilter.resolve(kind, reference, robot)
    except ApiError as error:
        error.detail = f"{option}: {error.detail}" if option else error.detail
        raise
    told = f" ({found.name!r})" if found.name and found.number else ""
    whose = "" if robot or found.number else f" of robot {found.robot!r}"
    return found.id, None if found.by in SAID else f"{kind} {reference!r} is {found.id}{told}{whose}"


def resolved_all(
    kilter: Kilter, kind: Kind, references: Iterable[str], robot: str | None, as_json: bool, option: str = ""
) -> list[str]:
    """Return the ids that references stand for, and say them."""
    return [resolve_reference(kilter, kind, reference, robot, as_json, option) for reference in references]


def resolved_options(
    kilter: Kilter, options: dict[str, Any], robot: str, as_json: bool, typed: Mapping[str, str] = MappingProxyType({})
) -> dict[str, Any]:
    """Return the options of a job with ids instead of references to versions.

    ``typed`` says which option of the command stands for one of the job, where the names differ.
    """
    named = {key: value for key, value in options.items() if key in ("start", "version") and isinstance(value, str)}
    return options | {
        key: resolve_reference(kilter, "version", value, robot, as_json, f"--{typed.get(key, key)}")
        for key, value in named.items()
    }
