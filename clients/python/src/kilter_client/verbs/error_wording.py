"""Errors in terms of a script: its verbs and their arguments.

The server speaks of requests ("options.level", "GET /v1/..."), and of the command ("--role confirmation"), which whoever
wrote ``k.identify(..., level=7)`` did not type.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from kilter_client.errors import KilterError

ROUTES: Mapping[str, str] = {
    "GET /v1/jobs": "k.jobs()",
    "GET /v1/robots": "k.robots()",
    "GET /v1/robots/{robot}/campaigns": "k.campaigns(robot)",
    "GET /v1/robots/{robot}/versions": "k.versions(robot)",
    "POST /v1/robots": "k.add_robot(...)",
    "POST /v1/versions/{id}/activate": "k.activate(version)",
}
ROUTE = re.compile(r"\b(?:GET|POST|PATCH|PUT|DELETE) /v1/[\w/{}.-]*[\w}]")
# Arguments that a verb calls otherwise than the request or the command does.
OTHER_NAMES: Mapping[str, str] = {"format": "form", "map": "column_map", "remarks": "notes"}
REWORDED: Sequence[tuple[str, str]] = (
    (r"kilter (?:(?:measure )?campaigns|versions?) (retire|restore) (\w+)", r'k.\1("\2")'),
    (r"kilter robot (retire|restore) ([\w.-]+)", r'k.\1("\2", kind="robot")'),
    (r"kilter (?:server )?jobs watch (\w+)", r'k.wait("\1")'),
    (r"kilter robot add", "k.add_robot(...)"),
    (r'kilter activate --force --reason TEXT`, \{"force": true, "reason": TEXT\}', "force=True, reason=...`"),
    (r"kilter (?:version |server )?(upload|identify|gap|evaluate|plan|activate|correct|export|jobs)\b", r"k.\1"),
)
PLACE = re.compile(r"\b(?:options|body|query)\.(\w+)")
OPTION = re.compile(
    r"--([a-z]+(?:-[a-z0-9]+)*)(?: (\w+\.toml|(?:cmp|ver|job)_\w+|confirmation|validation|train|same|coupled))?"
)
COMMANDS = re.compile(r"(`kilterd? (?:(?:measure )?inspect|serve\b)[^`]*`)")  # they are for a terminal here too


def rephrase_error(error: KilterError) -> None:
    """Put the sentence of an error in the words of a script."""
    error.detail = in_words(error.detail)
    error.args = (error.detail,)


def in_words(sentence: str) -> str:
    """Return a sentence with verbs for routes and commands, and arguments for places and options."""
    parts = COMMANDS.split(sentence)
    return "".join(part if k % 2 else _in_words(part) for k, part in enumerate(parts))


def _in_words(text: str) -> str:
    text = ROUTE.sub(lambda found: ROUTES.get(found[0], "another verb"), text)
    for pattern, words in REWORDED:
        text = re.sub(pattern, words, text)
    text = PLACE.sub(lambda found: _name(found[1]), text)
    return OPTION.sub(lambda found: f"{_name(found[1])}={_value(found[2])}", text)


def _name(name: str) -> str:
    plain = name.replace("-", "_")
    return OTHER_NAMES.get(plain, plain)


def _value(value: str | None) -> str:
    return "" if value is None else f'"{value}"'
