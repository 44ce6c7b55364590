"""Sections on the commands of `kilter` and `kilterd`, from the commands themselves."""

from __future__ import annotations

import argparse
import re
import textwrap
from collections.abc import Iterator
from typing import Any

from kilter_client.cli.catalogue import GROUPS, SUMMARIES
from kilter_client.cli.groups import command

WIDTH = 120
EVERYWHERE = ("--help", "--json")  # said once, at the top of the page


def sections_of_commands(group: str) -> str:
    """Return a section for each command of a group of the first level; of `kilter`, for those that are in no group."""
    names = [name for name in SUMMARIES if name not in GROUPS] if group == "kilter" else [group]
    return "\n".join(section for name in names for section in _sections(command(name), f"kilter {name}"))


def _sections(found: Any, words: str) -> Iterator[str]:
    commands = getattr(found, "commands", None)
    if commands is None:
        usage = " ".join([words, *(_argument(one) for one in found.params if one.param_type_name == "argument")])
        rows = [row for row in map(_row, found.params) if row]
        table = ["", "| option | meaning |", "|---|---|", *rows] if rows else []
        yield "\n".join([f"### `{usage}`", _paragraphs(found.help or ""), *table, ""])
        return
    for name, inner in commands.items():
        yield from _sections(inner, f"{words} {name}")
    if by_default := getattr(found, "by_default", ""):
        yield f"`{words}` alone is `{words} {by_default}`.\n"


def _argument(parameter: Any) -> str:
    choices = parameter.type_descriptor.choices or ()
    word = "|".join(map(str, choices)) or str(parameter.metavar or parameter.name).strip("[].").upper()
    word += "..." if parameter.nargs < 0 else ""
    return word if parameter.required else f"[{word}]"


def _paragraphs(text: str) -> str:
    kept = [" ".join(one.split()).replace("...", "…").replace("<", "\\<") for one in text.split("\n\n")]
    return "\n\n".join(textwrap.fill(one, WIDTH, break_long_words=False, break_on_hyphens=False) for one in kept)


def _row(parameter: Any) -> str:
    names = [*parameter.opts, *parameter.secondary_opts]
    if parameter.param_type_name == "argument" or names[0] in EVERYWHERE:
        return ""
    long = sorted(names, key=lambda text: not text.startswith("--"))
    value = "" if parameter.is_flag else f" `{_value(parameter)}`"
    return f"| {', '.join(f'`{text}`' for text in long)}{value} | {_command_cell(parameter)} |"


def _value(parameter: Any) -> str:
    if parameter.metavar:
        return str(parameter.metavar).replace("|", " or ")
    choices = parameter.type_descriptor.choices
    if choices:
        return " or ".join(map(str, choices))
    kinds = {"float": "NUMBER", "int": "NUMBER", "str": "TEXT", "Path": "FILE"}
    shown = re.findall(r"float|int|str|Path", str(parameter.type_descriptor.annotation))
    return kinds[shown[0]] if shown else "TEXT"


def _command_cell(parameter: Any) -> str:
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
