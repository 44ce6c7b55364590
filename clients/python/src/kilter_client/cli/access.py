"""``kilter server token``, ``kilter server whoami`` and ``kilter server audit``: who may do what, and who did what."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

import typer

from kilter_client import Kilter
from kilter_client.cli.groups import Group
from kilter_client.cli.terminal.arguments import Details, Json, Robot, split_names
from kilter_client.cli.terminal.output import emit, note, print_line, show_list, show_rows

FEW = 2  # entries whose changes fit on one screen
LONGEST = 36  # characters of a route or a thing in a line of the audit

token = typer.Typer(help="Make, list and revoke tokens.", rich_markup_mode=None, cls=Group)

TokenName = Annotated[str, typer.Argument(help="Whose it is or what it is for.", metavar="NAME", show_default=False)]
Role = Annotated[
    Literal["viewer", "operator", "admin"],
    typer.Option(
        help="viewer reads; operator also uploads, runs jobs, corrects and activates; admin also has robots, tokens, purging "
        "and the audit."
    ),
]
Robots = Annotated[
    list[str] | None, typer.Option("--robot", help="Limit it to this robot; repeat for more. Left out: all robots.")
]
Days = Annotated[int, typer.Option(min=0, max=3650, help="After how many days it expires; 0: never.")]
Head = Annotated[
    str | None,
    typer.Option(metavar="NUMBER:SHA256", help="With --verify: an entry noted earlier, which must still be there."),
]
Verify = Annotated[bool, typer.Option("--verify", help="Compute all hashes anew and show the last entry to note.")]


def register(app: typer.Typer) -> None:
    """Add the commands to the ``kilter`` command."""
    app.add_typer(token, name="token")
    app.command(epilog="Example: kilter server stream-session ur10 --stream line1")(stream_session)
    app.command(epilog="Example: kilter server whoami")(whoami)
    app.command(epilog="Example: kilter server login")(login)
    app.command(epilog="Example: kilter server audit --limit 20")(audit)


@token.callback(invoke_without_command=True)
def default(context: typer.Context, as_json: Json = False) -> None:
    """Make, list and revoke tokens; without a command, list them."""
    if context.invoked_subcommand is None:
        list_(as_json=as_json)


@token.command(epilog="Example: kilter server token add anna --role operator --robot ur10")
def add(name: TokenName, role: Role = "viewer", robots: Robots = None, days: Days = 365, as_json: Json = False) -> None:
    """Make a token; what to set KILTER_TOKEN to is shown this once only."""
    with Kilter() as kilter:
        made = kilter.add_token(name, role, robots=split_names(robots) or None, days=days or None)
    emit(made, as_json, _show_made)


@token.command("list", epilog="Example: kilter server token list")
def list_(as_json: Json = False) -> None:
    """List the tokens, newest first; also those that expired or were revoked."""
    with Kilter() as kilter:
        emit({"tokens": kilter.tokens()}, as_json, _show_list)


@token.command(epilog="Example: kilter server token revoke anna")
def revoke(
    name: Annotated[str, typer.Argument(help="Its id or its name.", metavar="TOKEN", show_default=False)],
    as_json: Json = False,
) -> None:
    """End a token at once."""
    with Kilter() as kilter:
        emit(
            kilter.revoke_token(name),
            as_json,
            lambda gone: print_line(f"Token {gone['name']} ({gone['id']}) is revoked."),
        )


def stream_session(
    robot: Robot,
    stream: Annotated[str, typer.Option("--stream", help="Name of the stream.")] = "main",
    lifetime_h: Annotated[float, typer.Option("--lifetime-h", help="How long it is valid, hours.")] = 24.0,
    take_over: Annotated[
        bool, typer.Option("--take-over", help="End the session of somebody else who holds the stream.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Print id and keys of a new session of a stream; whoever has them can send setpoints on it."""
    with Kilter() as kilter:
        emit(kilter.robots.stream_session(robot, stream, lifetime_h, take_over), as_json, _show_session)


def whoami(as_json: Json = False) -> None:
    """Show who sends requests, in which role, and for which robots."""
    with Kilter() as kilter:
        emit(kilter.whoami(), as_json, lambda one: print_line(f"{one['actor']}: {one['role']} of {_robots(one)}"))


def login(
    minutes: Annotated[int, typer.Option(min=1, max=60, help="For how long it can be used, minutes.")] = 5,
    as_json: Json = False,
) -> None:
    """Print a link that logs a browser in, once, in the role of your token. Whoever opens it first is logged in."""
    with Kilter() as kilter:
        made = dict(kilter.login_link(minutes))
        made["url"] = kilter.url + made["path"]
    emit(made, as_json, _show_link)


def audit(
    verify: Verify = False,
    head: Head = None,
    limit: Annotated[int, typer.Option(min=1, help="How many of the newest entries to show.")] = 50,
    details: Details = False,
    as_json: Json = False,
) -> None:
    """Show who changed what, from where; --details shows before and after. Or check that the audit is whole."""
    with Kilter() as kilter:
        if verify:
            emit(kilter.verify_audit(head), as_json, _show_verified)
        else:
            emit(
                {"entries": kilter.audit()[-limit:]}, as_json, _show_changes if details or limit <= FEW else _show_audit
            )


def _show_made(made: dict[str, Any]) -> None:
    print_line(made["token"])
    until = f"until {made['expires_at'][:10]}" if made["expires_at"] else "without an end"
    note(
        f"Token {made['name']} ({made['id']}), {made['role']} of {_robots(made)}, {until}. It is shown this once only."
    )


def _show_link(made: dict[str, Any]) -> None:
    print_line(made["url"])
    note(f"It logs in one browser, once, until {made['expires_at'][11:16]} UTC.")


def _robots(one: dict[str, Any]) -> str:
    return "all robots" if one["robots"] is None else ", ".join(one["robots"])


def _show_session(document: dict[str, Any]) -> None:
    for name in ("site", "robot", "stream", "session", "key", "announcement_key"):
        print_line(f"{name}: {document[name]}")
    for warning in document.get("warnings") or ():
        note(f"warning: {warning['message']}")
    note(f"It ends at {document['expires_at']}. The keys are shown this once only.")


def _show_list(document: dict[str, Any]) -> None:
    rows = [
        (
            one["id"],
            one["name"],
            one["role"],
            _robots(one),
            one["created_by"],
            (one["expires_at"] or "never")[:10],
            (one["revoked_at"] or "")[:10],
        )
        for one in document["tokens"]
    ]
    show_list(("token", "name", "role", "robots", "made by", "expires", "revoked"), rows)


def _show_verified(found: dict[str, Any]) -> None:
    print_line(
        f"The audit is whole: {found['entries']} entries. To see later that none was cut off, note the last one:"
    )
    print_line(found["head"])


def _show_changes(document: dict[str, Any]) -> None:
    rows = []
    for entry in document["entries"]:
        place = "/".join(json.loads(entry["place"]).values())
        changes = "; ".join(f"{c['thing']}: {c['before'][:60]} -> {c['after'][:60]}" for c in entry["changes"][:3])
        at = entry["at"][:19].replace("T", " ")
        rows.append((str(entry["number"]), at, entry["actor"], entry["address"], entry["route"], place, changes))
    show_rows(("entry", "at", "who", "from", "route", "what", "before -> after"), rows)


def _show_audit(document: dict[str, Any]) -> None:
    """Print an entry a line, without the values before and after."""
    rows = []
    for entry in document["entries"]:
        first, *others = [_cut(str(change["thing"])) for change in entry["changes"]] or [""]
        more = f" and {len(others)} more" if others else ""
        at = entry["at"][:16].replace("T", " ")
        rows.append((str(entry["number"]), at, entry["actor"], _cut(entry["route"]), first + more))
    show_list(("entry", "at", "who", "route", "changed"), rows, newest_last=True)


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
