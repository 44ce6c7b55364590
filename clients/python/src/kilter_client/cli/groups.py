"""Groups of commands: the first level, whose modules are imported when they are needed, and help that cuts no line."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from functools import cache
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup

from kilter_client.cli.catalogue import ENTRIES, GROUPS, MOVED, SUMMARIES

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
    """A group one of whose commands may be left out: ``kilter version list ur10`` lists as it always did."""

    by_default: str = ""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the command before what is none."""
        if self.by_default and args and args[0] != "--help" and self.get_command(ctx, args[0]) is None:
            args = [self.by_default, *args]
        return super().parse_args(ctx, args)


class FirstLevel(TyperGroup):
    """`kilter` itself: its commands come from the catalogue, a module is imported for a command that is asked for."""

    @property
    def commands(self) -> Any:
        """All commands and groups by name, which imports all their modules."""
        return {name: command(name) for name in SUMMARIES}

    @commands.setter
    def commands(self, _: Any) -> None:
        """Take nothing: the catalogue says which commands there are."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names, in the order of the catalogue."""
        return list(SUMMARIES)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return one command or group; also one that stood here in the release before."""
        return command(cmd_name) if cmd_name in GROUPS or cmd_name in ENTRIES else None

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands, then the groups."""
        width = max(map(len, SUMMARIES))
        for heading, is_group in (("Commands", False), ("Groups (kilter GROUP --help)", True)):
            shown = [(name.ljust(width), text) for name, text in SUMMARIES.items() if (name in GROUPS) is is_group]
            with formatter.section(heading):
                formatter.write_dl(shown)


class CatalogueGroup(WithDefault):
    """A group of the first level: commands of the catalogue, and those of a group that a module registers."""

    def __init__(self, name: str) -> None:
        """Take what the catalogue says of ``name``; no module is imported yet."""
        self._place = GROUPS[name]
        super().__init__(name=name, help=self._place.summary, no_args_is_help=True, rich_markup_mode=None)
        self.by_default = self._place.by_default

    @property
    def _own(self) -> Mapping[str, Any]:
        return _load_command(self._place.own).commands if self._place.own else {}

    @property
    def commands(self) -> Any:
        """All its commands by name, which imports all their modules."""
        return {**self._own, **{name: _load_command(other) for name, other in self._place.commands.items()}}

    @commands.setter
    def commands(self, _: Any) -> None:
        """Take nothing: the catalogue says which commands there are."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names, the group's own first."""
        return [*self._own, *self._place.commands]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write its commands, each with one line."""
        rows = [(name, _first_thought(found.help or "")) for name, found in self._own.items()]
        rows += [(name, ENTRIES[other].summary) for name, other in self._place.commands.items()]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return one command."""
        if cmd_name in self._place.commands:
            return _load_command(self._place.commands[cmd_name])
        return self._own.get(cmd_name)


def join_version_words(arguments: Sequence[str]) -> list[str]:
    """Return the arguments of a command line with `tour v2` as one, as a person types it without quotes.

    Where --robot is given, a number stands by itself.
    """
    if "--robot" in arguments or not any(map(VERSION_NUMBER.fullmatch, arguments[2:])):
        return list(arguments)
    _, first = find_command(arguments)  # words of the command itself do not name a robot
    joined = list(arguments[: first + 1])
    for one in arguments[first + 1 :]:
        if VERSION_NUMBER.fullmatch(one) and NO_ROBOT.fullmatch(joined[-1]) is None:
            joined[-1] += f" {one}"
        else:
            joined.append(one)
    return joined


def find_command(words: Sequence[str]) -> tuple[Any, int]:
    """Return the command that words call, None when they call none, and how many of them name it.

    Of a group the command that may be left out counts, where there is one.
    """
    if not words or (words[0] not in GROUPS and words[0] not in ENTRIES):
        return None, 0
    found, first = command(words[0]), 1
    while hasattr(found, "get_command"):
        inside = found.get_command(None, words[first]) if first < len(words) else None
        if inside is None:
            return found.get_command(None, getattr(found, "by_default", "")), first
        found, first = inside, first + 1
    return found, first


@cache
def command(name: str) -> Any:
    """Return a command or a group of the first level."""
    return CatalogueGroup(name) if name in GROUPS else _load_command(name)


def find_new_spelling(words: Sequence[str]) -> str:
    """Return how words are spelled that call a command by its place in the release before; empty: as they are."""
    return MOVED.get(words[0], "") if words and words[0] not in GROUPS else ""


def _load_command(name: str) -> Any:
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
