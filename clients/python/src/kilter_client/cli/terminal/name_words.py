"""What has an id, as people read it: `tour v2`, the name of a campaign or a job. Programs read ids with --json."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping
from typing import Any

from kilter_client import Kilter
from kilter_client.errors import KilterError, NotFoundError
from kilter_client.requests.calls.references import Kind
from kilter_client.requests.steps import Request, Steps, refuse

ID = re.compile(r"\b(?:ver|cmp|job)_[0-9a-f]{16}\b")
KINDS: Mapping[str, Kind] = {"ver": "version", "cmp": "campaign", "job": "job"}
SHORT = 12  # characters of an id without a name: a reference all the same
ANSWER_S = 2.0  # a name is not worth a longer wait

_names: dict[str, str] = {}
_unasked = [True]  # empty: the server did not answer


def name_ids(text: str, versions_only: bool = False) -> str:
    """Return a text with names instead of ids, said once; an id that the server does not know stays.

    ``versions_only``: where a name would not do, as of two campaigns called alike.
    """
    for key in dict.fromkeys(ID.findall(text)):
        if versions_only and not key.startswith("ver_"):
            continue
        word = _names.get(key) or _ask(key)
        if not key.startswith("ver_"):
            plain = "".join(shlex.split(word))
            for twice in (f"{key} {plain!r}", f"{key} ({plain!r})", f"{key} ({plain})"):
                text = text.replace(twice, key)
            text = text.replace(f"called {plain!r} already, {key}", f"called {plain!r} already")
        text = text.replace(key, word)
    return text


def remember_names(document: Any) -> None:
    """Learn the names in a document of the server, so that nobody asks for them; what a version cites may be renamed."""
    for one in document.values() if isinstance(document, Mapping) else document:
        if isinstance(one, Mapping | list | tuple):
            remember_names(one)
    if isinstance(document, Mapping) and ID.fullmatch(str(document.get("id"))) and {"name", "robot"} <= document.keys():
        _names[document["id"]] = _word(document["id"], document)


def begin_command() -> None:
    """Ask the server again, though it did not answer the command before."""
    _unasked[:] = [True]


def _word(key: str, found: Mapping[str, Any]) -> str:
    if found.get("number"):
        return f"{found['robot']} v{found['number']}"
    return shlex.quote(found["name"]) if found["name"] else key[:SHORT]


def _ask(key: str) -> str:
    """Ask the server, once for each id; where it does not answer at once, no more in this command."""
    if _unasked:
        try:
            with Kilter() as kilter:
                _names[key] = _word(key, kilter.run(_resolve_once(key)))
        except NotFoundError:
            _names[key] = key
        except (KilterError, ValueError):
            _unasked.clear()
    return _names.get(key, key)


def _resolve_once(key: str) -> Steps[Any]:
    """Ask without patience: neither a busy server nor a lost one is asked again."""
    answer = yield Request("GET", "/v1/resolve", {"kind": KINDS[key[:3]], "reference": key}, timeout_s=ANSWER_S)
    refuse(answer.status, answer.content)
    return json.loads(answer.content)
