"""Flags of the options of jobs, made from what the contract says of them."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Annotated, Any, Literal, get_type_hints

import typer

from kilter_client.cli.terminal import arguments
from kilter_client.typed.option_texts import KINDS

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
        return arguments.split_names(value)
    if form != "json":
        return value
    try:
        return json.loads(value)
    except ValueError:
        return value  # the server says what it takes
