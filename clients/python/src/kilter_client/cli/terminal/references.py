"""References on the command line: the command says what they stand for before it uses them.

What Ctrl-C leaves: one sentence with what is stored and how to continue, and exit code 130.

Errors of the server in terms of the command that was typed: its options, its arguments, its commands.

The server speaks of requests ("options.loss", "query.format", "POST /v1/..."); whoever typed ``--loss`` reads ``--loss``.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import MappingProxyType
from typing import Annotated, Any, ClassVar

import typer

from kilter_client import Kilter
from kilter_client.cli.groups import find_command
from kilter_client.cli.terminal.output import note
from kilter_client.errors import ApiError, KilterError
from kilter_client.resources import Kind, is_full

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


CODE = 130
UNKNOWN = (
    "Interrupted. The server finishes what it had begun: "
    "`kilter server jobs` and `kilter measure campaigns ROBOT` show what is there."
)


class InterruptedCommandError(KilterError):
    """Ctrl-C, with what it left behind."""

    default_code: ClassVar[str] = "interrupted"
    default_title: ClassVar[str] = "Interrupted"


@contextmanager
def on_interrupt(tell: Callable[[], str]) -> Iterator[None]:
    """Say what ``tell`` returns when the person presses Ctrl-C inside.

    Raises:
        InterruptedCommandError: Ctrl-C was pressed.

    """
    try:
        yield
    except KeyboardInterrupt:
        raise InterruptedCommandError(f"Interrupted: {tell()}") from None


def job_goes_on(job: Mapping[str, Any] | str) -> str:
    """Say that a job goes on, and the commands for it; a text is its name or id."""
    named = shlex.quote(job if isinstance(job, str) else job_name(job))
    return (
        f"job {named} continues at the server. `kilter server jobs watch {named}` follows it, "
        f"`kilter server jobs cancel {named}` stops it."
    )


def job_name(job: Mapping[str, Any]) -> str:
    """Return what a job is called; where a server of an earlier release says nothing, its id."""
    return str(job.get("name") or job["id"])


def fleet_goes_on(fleet_id: str) -> str:
    """Say that a fleet job goes on, and the commands for it."""
    return (
        f"fleet job {fleet_id} continues at the server. `kilter robot fleet watch {fleet_id}` follows it, "
        f"`kilter robot fleet cancel {fleet_id}` stops it."
    )


# Where a message names a route as the remedy, the command that uses it.
ROUTES: Mapping[str, str] = {
    "GET /v1/fleet-jobs": "`kilter robot fleet list`",
    "GET /v1/jobs": "`kilter server jobs`",
    "GET /v1/robots/{robot}/campaigns": "`kilter measure campaigns ROBOT`",
    "GET /v1/robots/{robot}/meshes": "`kilter robot mesh list ROBOT`",
    "GET /v1/robots/{robot}/versions": "`kilter version list ROBOT`",
    "POST /v1/versions/{id}/activate": "`kilter activate VERSION`",
}
ROUTE = re.compile(r"\b(?:GET|POST|PATCH|PUT|DELETE) /v1/[\w/{}.-]*[\w}]")
# Names of the request that are other names in the commands, where the command has no parameter of the first name.
OTHER_NAMES: Mapping[str, str] = {
    "version": "start",
    "box_mm": "box",
    "payloads_kg": "payload_kg",
    "within": "anywhere",
    "campaigns": "campaign",
    "causes": "cause",
    "format": "form",
    "remarks": "text",
    "notes": "text",
}
PLACE = re.compile(r"\b(?:options|body|query|path)((?:\.\w+)+)")
QUOTED = re.compile(r"`(\w+)`")
FIRST = re.compile(r"^(\w+)(?= (?:is|are|must be|has|have|goes)\b)")
ADD_TO = re.compile(r", add to that one with --campaign \w+")  # an option of `kilter upload` alone
PLAIN: Sequence[tuple[str, str]] = (
    (", for a job of kind \\w+", ""),
    (r"\b[Ii]nput should be", "it should be"),
    (r"\bString should have", "the text should have"),
    (r"\bField required", "it is missing"),
)
NOT_KNOWN = ("not_found", "method_not_allowed")


def rephrase_error(error: KilterError, arguments: Sequence[str]) -> KilterError:
    """Return the error with its sentence in the words of the command line ``arguments``."""
    if error.code in NOT_KNOWN:
        error.detail = (
            "The server does not know what this command asks for: it may be of another release. "
            "`kilter --version` shows both."
        )
        return error
    error.detail = in_words(error.detail, parameters_by_request_name(arguments), str(error.context.get("option") or ""))
    return error


def in_words(detail: str, flags: Mapping[str, str], option: str = "") -> str:
    """Return a sentence with places of a request as ``flags`` (request name to option) name them.

    ``option`` is the one that the refusal is about; it is put before a sentence that does not name it.
    """
    said = ROUTE.sub(lambda found: ROUTES.get(found[0], "another command"), detail)
    said = PLACE.sub(lambda found: _flag(found[1][1:].split("."), flags, found[0].startswith("options")), said)
    said = QUOTED.sub(lambda found: flags.get(found[1], found[0]), said)
    said = FIRST.sub(lambda found: flags.get(found[1], found[0]), said)
    for pattern, plain in PLAIN:
        said = re.sub(pattern, plain, said)
    if "campaign" not in flags:
        said = ADD_TO.sub("", said)
    flag = flags.get(option, "")
    said = said if not flag.startswith("--") or flag in said else f"{flag}: {said}"
    return said if said.endswith((".", "!", "?")) else f"{said}."


def parameters_by_request_name(arguments: Sequence[str]) -> dict[str, str]:
    """Return the options and arguments of the command that was typed, by what the request calls them."""
    command, _ = find_command([word for word in arguments if not word.startswith("-")])
    found = {} if command is None else {parameter.name: _parameter_label(parameter) for parameter in command.params}
    for name, other in OTHER_NAMES.items():
        if name not in found and other in found:
            found[name] = found[other]
    return found


def _parameter_label(parameter: Any) -> str:
    if parameter.param_type_name == "argument":
        return str(parameter.metavar or parameter.name.upper())
    return str(next((text for text in parameter.opts if text.startswith("--")), parameter.opts[0]))


def _flag(parts: Sequence[str], flags: Mapping[str, str], of_job: bool) -> str:
    """Return how a place is typed: its option, what stands inside it behind that; list numbers are left out."""
    known = [k for k, part in enumerate(parts) if part in flags]
    if known:  # the last one: what stands before it may be the form of a document
        inside = [name for name in parts[known[-1] + 1 :] if not name.isdecimal()]
        return " ".join([flags[parts[known[-1]]], *inside])
    name = ".".join(part for part in parts if not part.isdecimal()) or ".".join(parts)
    return f"--option {name}" if of_job and "option" in flags else ".".join(parts)
