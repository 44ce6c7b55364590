"""Tables of the options of `kilter` and `kilterd`, from the commands themselves."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from typing import Any

from kilter_client.cli.groups import command

EVERYWHERE = ("--help", "--json")  # said once, at the top of the page


def table_of_command(name: str) -> str:
    """Return the table of the options of a command, `kilter robot add`; empty for one without."""
    rows = [row for row in map(_row, command_named(name).params) if row]
    return "\n".join(["| option | meaning |", "|---|---|", *rows]) + "\n" if rows else ""


def command_named(name: str) -> Any:
    """Return a command by its words."""
    _, first, *more = name.split()
    found = command(first)
    for word in more:
        found = found.commands[word]
    return found


def _row(parameter: Any) -> str:
    names = [*parameter.opts, *parameter.secondary_opts]
    if parameter.param_type_name == "argument" or names[0] in EVERYWHERE:
        return ""
    long = sorted(names, key=lambda text: not text.startswith("--"))
    value = "" if parameter.is_flag else f" `{_value(parameter)}`"
    return f"| {', '.join(f'`{text}`' for text in long)}{value} | {_cell(parameter)} |"


def _value(parameter: Any) -> str:
    if parameter.metavar:
        return str(parameter.metavar).replace("|", " or ")
    choices = parameter.type_descriptor.choices
    if choices:
        return " or ".join(map(str, choices))
    kinds = {"float": "NUMBER", "int": "NUMBER", "str": "TEXT", "Path": "FILE"}
    shown = re.findall(r"float|int|str|Path", str(parameter.type_descriptor.annotation))
    return kinds[shown[0]] if shown else "TEXT"


def _cell(parameter: Any) -> str:
    said = [(parameter.help or "").replace("|", "\\|").replace("...", "…")]
    if parameter.multiple and "repeat" not in said[0].lower():
        said.append("May be given again.")
    if not parameter.is_flag and parameter.default not in (None, "", (), []):
        said.append(f"Default: `{parameter.default}`.")
    if parameter.required:
        said.append("Must be given.")
    return " ".join(said)


def table_of_server() -> str:
    """Return the table of the commands of `kilterd` with their options."""
    return "\n".join(["| command | does | options |", "|---|---|---|", *_server_rows()]) + "\n"


def _server_rows() -> Iterator[str]:
    from kilter_service.run.program import parser

    for action in parser()._actions:
        if not isinstance(action, argparse._SubParsersAction):
            continue
        for name, one in action.choices.items():
            options = [
                f"`{a.option_strings[-1] if a.option_strings else a.metavar}`"
                for a in one._actions
                if a.help != argparse.SUPPRESS and a.dest != "help"
            ]
            yield f"| `kilterd {name}` | {one.description} | {', '.join(options)} |"
