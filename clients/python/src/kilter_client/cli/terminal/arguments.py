"""Arguments that several commands share, and what their text means.

Flags of the options of jobs, made from what the contract says of them.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Annotated, Any, Literal, get_type_hints

import typer

from kilter_client.errors import UsageError
from kilter_client.typed.option_texts import KINDS

Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on stdout and nothing else.")]
Details = Annotated[bool, typer.Option("--details", help="Print all that is known, and not only the answer.")]
Robot = Annotated[str, typer.Argument(help="Name of the robot.", metavar="ROBOT", show_default=False)]
File = Annotated[
    Path, typer.Argument(help="The file.", metavar="FILE", show_default=False, exists=True, dir_okay=False)
]
CampaignIds = Annotated[
    list[str] | None,
    typer.Option(
        "--campaign",
        "-c",
        metavar="ID",
        help="Campaign to use: id or its beginning, name, or `latest`; repeat for more.",
        show_default=False,
    ),
]
ValidationText = Annotated[
    list[str] | None,
    typer.Option(
        "--validation",
        "-v",
        metavar="ID|FRACTION|folds:K",
        help="What to hold out: campaign ids, a fraction of the poses (0.3), or K-fold (folds:5).",
        show_default=False,
    ),
]
HuntValidation = Annotated[
    list[str] | None,
    typer.Option(
        "--validation",
        "-v",
        metavar="ID|FRACTION",
        help="What to hold out: campaign ids, or a fraction of the poses (0.25); left out: a quarter of 60 poses or more. "
        "Of fewer, and with 0, one pose after the other is left out, and nothing is confirmed.",
        show_default=False,
    ),
]
ConfirmationIds = Annotated[
    list[str] | None,
    typer.Option(
        "--confirmation",
        metavar="ID",
        help="Campaign of another day or set-up in which the effects must be seen again; repeat for more.",
        show_default=False,
    ),
]
ColumnMap = Annotated[
    Path | None, typer.Option("--map", help="Column map of a lab's own file (TOML).", exists=True, dir_okay=False)
]
PayloadOnPath = Annotated[
    float | None, typer.Option(min=0.0, help="Mass on the tool along the whole path, kg; 0 for an empty tool.")
]
PayloadCentre = Annotated[
    str | None,
    typer.Option(metavar="X,Y,Z", help="Centre of the payload in the tool frame, mm; default: the tool point."),
]
NoWait = Annotated[bool, typer.Option("--no-wait", help="Return as soon as the job is queued.")]
Check = Annotated[
    bool,
    typer.Option(
        "--check",
        help="Only say what it would do: what it uses, what its data determine, what is missing, how long it takes.",
    ),
]
MoreOptions = Annotated[
    list[str] | None,
    typer.Option("--option", metavar="NAME=VALUE", help="Any other option of the job; the value is JSON or text."),
]
VersionId = Annotated[
    str,
    typer.Argument(
        help="Its number (`ur10 v2`), name, id or its beginning, or `latest`.",
        show_default=False,
        metavar="VERSION",
    ),
]
Retired = Annotated[bool, typer.Option("--retired", help="Also those that are out of use.")]
JobName = Annotated[str, typer.Option("--name", help="Name of the job and of the version that it makes.")]


def validation(texts: Iterable[str] | None) -> list[str] | float | dict[str, int] | None:
    """Understand --validation: campaign ids, one fraction, or one ``folds:K``.

    Raises:
        UsageError: kinds mixed, or a fraction that is none.

    """
    given = split_names(texts)
    if not given:
        return None
    if len(given) == 1 and given[0].startswith("folds:"):
        count = given[0].removeprefix("folds:")
        if not count.isdecimal() or int(count) < 2:
            raise UsageError(f"--validation {given[0]}: give folds:K with K from 2, for example folds:5.")
        return {"folds": int(count)}
    if len(given) == 1 and _is_fraction(given[0]):
        fraction = float(given[0])
        if not 0 <= fraction < 1:
            raise UsageError(
                f"--validation {given[0]}: a fraction lies between 0 and 1, for example 0.3; 0 is nothing."
            )
        return fraction
    if any(text.startswith("folds:") or _is_fraction(text) for text in given):
        raise UsageError("--validation takes campaign ids, or one fraction, or one folds:K, not a mixture.")
    return given


def _is_fraction(text: str) -> bool:
    """Whether a text is a number; one that may be the beginning of an id (64, 1e5) is none."""
    number = _number(text)
    return number is not None and not (number >= 1 and re.fullmatch("[0-9a-f]+", text))


def split_names(texts: Iterable[str] | None) -> list[str]:
    """Return names given as ``a,b`` or by repeating the option."""
    return [name.strip() for text in texts or () for name in text.split(",") if name.strip()]


def three(name: str, text: str | None) -> list[float] | None:
    """Understand three numbers given as ``a,b,c``.

    Raises:
        UsageError: other than three numbers.

    """
    if text is None:
        return None
    found = [_number(part) for part in text.split(",")]
    if len(found) != 3 or None in found:
        raise UsageError(f"{name} {text}: give three numbers, for example 0,0,-50.")
    return [part for part in found if part is not None]


def numbers(name: str, text: str) -> list[float]:
    """Understand numbers given as ``a,b``.

    Raises:
        UsageError: something that is not a number.

    """
    found = [_number(part) for part in text.split(",")]
    if None in found:
        raise UsageError(f"{name} {text}: give numbers with commas between them, for example 0,2.5.")
    return [part for part in found if part is not None]


def effects(texts: Iterable[str] | None) -> list[str | dict[str, Any]]:
    """Understand --effects: ids as ``a,b``, or a JSON document of one effect with its joints."""
    found: list[str | dict[str, Any]] = []
    for text in texts or ():
        if text.lstrip().startswith("{"):
            found.append(_document(text))
        else:
            found += split_names([text])
    return found


def options(more: Iterable[str] | None, **given: Any) -> dict[str, Any]:
    """Collect a job's options: those that were given, and every NAME=VALUE of --option.

    Raises:
        UsageError: an --option without ``=``.

    """
    chosen = {name: value for name, value in given.items() if value is not None and value != [] and value is not False}
    for text in more or ():
        name, equals, value = text.partition("=")
        if not equals or not name.strip():
            raise UsageError(f"--option {text}: give NAME=VALUE, for example --option seed=1.")
        try:
            chosen[name.strip()] = json.loads(value)
        except ValueError:
            chosen[name.strip()] = value
    return chosen


def _number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None


def _document(text: str) -> dict[str, Any]:
    try:
        return dict(json.loads(text))
    except ValueError as error:
        raise UsageError(f"--effects {text}: is not a JSON object ({error}).") from error


TYPES: Mapping[str, Any] = {
    "flag": bool,
    "integer": int,
    "number": float,
    "names": list[str],
    "text": str,
    "json": str,
}  # another form is choices with bars between
METAVARS = {"names": "A,B", "json": "JSON", "start": "VERSION", "version": "VERSION"}  # by form or by name


def make_flags(kind: str, names: Iterable[str]) -> Iterator[Parameter]:
    """Return a parameter of a command for each of some options of a kind."""
    about = KINDS[kind]
    for name in names:
        form = about.forms[name]
        taken = TYPES.get(form) or Literal[tuple(form.split("|"))]
        dashed = name.replace("_", "-")
        flag = f"--{dashed}/--no-{dashed}" if form == "flag" else f"--{dashed}"
        option = typer.Option(
            flag, metavar=METAVARS.get(name, METAVARS.get(form)), help=about.help[name], show_default=False
        )
        yield Parameter(name, Parameter.POSITIONAL_OR_KEYWORD, default=None, annotation=Annotated[taken | None, option])


def read_flags(kind: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return options as a job takes them from the values of their flags; those that were not given are left out."""
    return {name: _read(KINDS[kind].forms[name], value) for name, value in given.items() if value not in (None, [])}


def with_flags(kind: str, seldom: Iterable[str] = ()) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command a flag for each option of its kind that it does not name; ``seldom`` are left to ``--option``."""

    def add(command: Callable[..., None]) -> Callable[..., None]:
        own, hints = list(signature(command).parameters.values()), get_type_hints(command, include_extras=True)
        missing = [name for name in KINDS[kind].forms if name not in hints and name not in seldom]

        @wraps(command)
        def whole(**given: Any) -> None:
            chosen = read_flags(kind, {name: given.pop(name) for name in missing})
            given["option"] = [*(given["option"] or ()), *(f"{name}={json.dumps(one)}" for name, one in chosen.items())]
            command(**given)

        place = next(k for k, one in enumerate(own) if one.name == "option")
        parameters = [one.replace(annotation=hints[one.name]) for one in own]
        return with_parameters(whole, [*parameters[:place], *make_flags(kind, missing), *parameters[place:]])

    return add


def with_parameters(command: Callable[..., None], parameters: list[Parameter]) -> Callable[..., None]:
    """Give a command the parameters by which typer makes its flags."""
    made: Any = command
    made.__signature__ = Signature(parameters)
    made.__annotations__ = {}
    return command


def _read(form: str, value: Any) -> Any:
    if form == "names":
        return split_names(value)
    if form != "json":
        return value
    try:
        return json.loads(value)
    except ValueError:
        return value  # the server says what it takes
