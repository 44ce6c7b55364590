"""``name``, ``note``, ``retire``, ``restore`` and ``purge`` of campaigns, versions and robots."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from kilter_client import Kilter
from kilter_client.cli.groups import WithDefault
from kilter_client.cli.terminal.arguments import Json, Robot
from kilter_client.cli.terminal.output import emit, print_line
from kilter_client.cli.terminal.references import OfRobot, resolve_reference
from kilter_client.errors import ApiError, UsageError
from kilter_client.resources import Kind, is_full

ResourceReference = Annotated[
    str, typer.Argument(metavar="ID", help="Its id or the beginning of it, its name, or `latest`.", show_default=False)
]
Text = Annotated[str, typer.Argument(help="The text.", show_default=False)]
COMMANDS = {"campaign": "measure campaigns", "version": "version", "robot": "robot"}
EXAMPLES = {"campaign": "cmp_1f", "version": "ur10 v2"}
PURGED = {"campaign": "cmp_1f61e82fd541c1ab", "version": "ver_7c61e82fd541c1ab"}
Yes = Annotated[bool, typer.Option("--yes", help="Confirm: this cannot be undone.")]


class ListsByDefault(WithDefault):
    """A group whose ``list`` may be left out."""

    by_default = "list"


def register(group: typer.Typer, kind: Kind) -> None:
    """Add the commands to ``kilter measure campaigns`` or ``kilter version list``."""
    _register_words(group, kind)
    _register_use(group, kind)


def _register_words(group: typer.Typer, kind: Kind) -> None:
    example = EXAMPLES[kind]

    @group.command(epilog=f'Example: kilter {COMMANDS[kind]} name {example} "after the crash"')
    def name(
        reference: ResourceReference,
        name: Annotated[str, typer.Argument(help="The name.", show_default=False)],
        notes: Annotated[str | None, typer.Option(help="Notes kept with it.")] = None,
        robot: OfRobot = None,
        as_json: Json = False,
    ) -> None:
        """Give it a name, which then stands for its id."""
        _change(kind, reference, robot, as_json, name=name, notes=notes)

    @group.command(epilog=f'Example: kilter {COMMANDS[kind]} note {example} "flange replaced"')
    def note(reference: ResourceReference, text: Text, robot: OfRobot = None, as_json: Json = False) -> None:
        """Add a note to it, replacing the previous one."""
        _change(kind, reference, robot, as_json, notes=text)


def _register_use(group: typer.Typer, kind: Kind) -> None:
    example = EXAMPLES[kind]

    @group.command(epilog=f"Example: kilter {COMMANDS[kind]} retire {example}")
    def retire(reference: ResourceReference, robot: OfRobot = None, as_json: Json = False) -> None:
        """Take it out of use: lists leave it out, no job uses it. What cites it stays as it is."""
        with Kilter() as kilter:
            document = _resource_for_kind(kilter, kind).retire(
                resolve_reference(kilter, kind, reference, robot, as_json)
            )
        emit(document, as_json, lambda _: print_line(f"{kind} {document['id']} is retired"))

    @group.command(epilog=f"Example: kilter {COMMANDS[kind]} restore {example}")
    def restore(reference: ResourceReference, robot: OfRobot = None, as_json: Json = False) -> None:
        """Bring it back into use."""
        with Kilter() as kilter:
            document = _resource_for_kind(kilter, kind).restore(
                resolve_reference(kilter, kind, reference, robot, as_json)
            )
        emit(document, as_json, lambda _: print_line(f"{kind} {document['id']} is in use again"))

    @group.command(epilog=f"Example: kilter {COMMANDS[kind]} purge {PURGED[kind]} --yes")
    def purge(
        full_id: Annotated[str, typer.Argument(metavar="ID", help="Its full id.", show_default=False)],
        yes: Yes = False,
        as_json: Json = False,
    ) -> None:
        """Delete it for good, if nothing cites it; its hash is kept."""
        with Kilter() as kilter:
            if not is_full(kind, full_id):
                raise UsageError(f"A purge takes the full id{_describe_reference(kilter, kind, full_id)}")
            _refuse_unsure(yes, f"kilter {COMMANDS[kind]} purge {full_id}")
            document = _resource_for_kind(kilter, kind).purge(full_id)
        emit(document, as_json, _show_tombstone)


def register_robot(group: typer.Typer) -> None:
    """Add the commands to ``kilter robot``."""

    @group.command(epilog='Example: kilter robot note ur10 "the left one"')
    def note(robot: Robot, text: Text, as_json: Json = False) -> None:
        """Add a note to a robot, replacing the previous one."""
        with Kilter() as kilter:
            emit(kilter.robots.note(robot, text), as_json, lambda _: print_line(f"robot {robot}: {text}"))

    @group.command(epilog="Example: kilter robot retire ur10")
    def retire(robot: Robot, as_json: Json = False) -> None:
        """Take a robot out of use: lists leave it out, nothing new is made of it. An active version keeps correcting."""
        with Kilter() as kilter:
            emit(kilter.robots.retire(robot), as_json, lambda _: print_line(f"robot {robot} is retired"))

    @group.command(epilog="Example: kilter robot restore ur10")
    def restore(robot: Robot, as_json: Json = False) -> None:
        """Bring a robot back into use."""
        with Kilter() as kilter:
            emit(kilter.robots.restore(robot), as_json, lambda _: print_line(f"robot {robot} is in use again"))

    @group.command(epilog="Example: kilter robot purge ur10 --yes")
    def purge(robot: Robot, yes: Yes = False, as_json: Json = False) -> None:
        """Delete a robot without campaigns and versions for good; its hash is kept."""
        _refuse_unsure(yes, f"kilter robot purge {robot}")
        with Kilter() as kilter:
            emit(kilter.robots.purge(robot), as_json, _show_tombstone)


def _resource_for_kind(kilter: Kilter, kind: Kind) -> Any:
    return kilter.campaigns if kind == "campaign" else kilter.versions


def _change(kind: Kind, reference: str, robot: str | None, as_json: bool, **words: str | None) -> None:
    with Kilter() as kilter:
        document = _resource_for_kind(kilter, kind).change(
            resolve_reference(kilter, kind, reference, robot, as_json), **words
        )
    told = f" {document['name']!r}" if document["name"] else ""
    emit(document, as_json, lambda _: print_line(f"{kind} {document['id']}{told}: {document['notes'] or 'no notes'}"))


def _describe_reference(kilter: Kilter, kind: Kind, reference: str) -> str:
    """Return what a reference that is not a full id stands for, as the end of a sentence."""
    try:
        return f": {reference!r} is {kilter.resolve(kind, reference).id}. Give that, if it is the one."
    except ApiError:  # nothing, or several of different robots
        return f", {reference!r} is not one: `kilter {COMMANDS[kind]} list ROBOT` lists them."


def _refuse_unsure(yes: bool, command: str) -> None:
    if not yes:
        raise UsageError(f"A purge cannot be undone: `{command} --yes` does it, retire can be taken back.")


def _show_tombstone(document: dict[str, Any]) -> None:
    print_line(f"{document['kind']} {document['id']} is purged (sha256 {document['sha256'][:12]} is kept)")
