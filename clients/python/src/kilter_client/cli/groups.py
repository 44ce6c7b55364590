"""Groups of commands: the first level, whose modules are imported when they are needed, and help that cuts no line."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from typing import Any, ClassVar

import typer
from typer.core import TyperGroup

from kilter_client.cli.catalogue import CATALOGUE, ENTRIES

VERSION_NUMBER = re.compile("v[1-9][0-9]*")
NO_ROBOT = re.compile("-.*|ver_.*|latest|nominal|" + VERSION_NUMBER.pattern)


class Group(TyperGroup):
    """A group whose help shows the first thought of each command's help, whole."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands, each with one line."""
        rows = [(name, _first_thought(command.help or "")) for name, command in self.commands.items()]
        if rows:
            with formatter.section("Commands"):
                formatter.write_dl(rows)


class WithDefault(Group):
    """A group one of whose commands may be left out: ``kilter versions ur10`` lists as it always did."""

    by_default: ClassVar[str]

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the command before what is none."""
        if args and args[0] not in self.commands and args[0] != "--help":
            args = [self.by_default, *args]
        return super().parse_args(ctx, args)


class FirstLevel(TyperGroup):
    """`kilter` itself: its commands come from the catalogue, a module is imported for a command that is asked for."""

    @property
    def commands(self) -> Any:
        """All commands by name, which imports all their modules."""
        return {name: command(name) for name in ENTRIES}

    @commands.setter
    def commands(self, _: Any) -> None:
        """Take nothing: the catalogue says which commands there are."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names, in the order of the catalogue."""
        return list(ENTRIES)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return one command."""
        return command(cmd_name) if cmd_name in ENTRIES else None

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands under their headings."""
        width = max(map(len, ENTRIES))
        for heading, entries in CATALOGUE.items():
            with formatter.section(heading):
                formatter.write_dl([(name.ljust(width), entry.summary) for name, entry in entries.items()])


def join_version_words(arguments: Sequence[str]) -> list[str]:
    """Return the arguments of a command line with `tour v2` as one, as a person types it without quotes.

    Where --robot is given, a number stands by itself.
    """
    if "--robot" in arguments or not any(map(VERSION_NUMBER.fullmatch, arguments[2:])):
        return list(arguments)
    level: Any = command(arguments[0]) if arguments[0] in ENTRIES else None
    first = 1
    while hasattr(level, "get_command") and first < len(arguments):  # a command or a group of them is no robot
        level, first = level.get_command(None, arguments[first]), first + 1
    joined = list(arguments[: first + 1])
    for one in arguments[first + 1 :]:
        if VERSION_NUMBER.fullmatch(one) and NO_ROBOT.fullmatch(joined[-1]) is None:
            joined[-1] += f" {one}"
        else:
            joined.append(one)
    return joined


def command(name: str) -> Any:
    """Return a command of the first level."""
    return _load_commands(ENTRIES[name].module)[name]


@cache
def _load_commands(module: str) -> Mapping[str, Any]:
    """Import a module and return the commands it registers."""
    app = typer.Typer(rich_markup_mode=None)
    app.callback()(_nothing)  # with one command alone typer would make no group
    import_module(f"kilter_client.cli.{module}").register(app)
    found: Any = typer.main.get_command(app)
    return dict(found.commands)


def _nothing() -> None:
    """Stand for the callback of a group that is never called itself."""


def _first_thought(text: str) -> str:
    """Return a help text up to the first full stop, colon or semicolon, which fits a line."""
    plain = " ".join(text.split("\n\n", 1)[0].split())
    return re.split(r"[.:;] ", plain, maxsplit=1)[0].rstrip(".") + "."
