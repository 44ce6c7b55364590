"""Requests drawn from the OpenAPI document of the application, with bodies of every kind it takes."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, NamedTuple
from urllib.parse import quote, urlencode

from hypothesis import strategies as st

from tests.fuzz.files import FILES, urdf
from tests.fuzz.shapes import Shapes
from tests.fuzz.values import RAW, texts

FREE = "free"  # answered by any status: streams that do not end are not followed


class Case(NamedTuple):
    """A request: the route it is for, the address as it is sent, and what goes with it."""

    method: str
    path: str
    address: str
    content: bytes | None
    headers: dict[str, str]


class Requests:
    """Draws requests to the routes of an OpenAPI document; ``known`` are the ids and names that exist, by parameter."""

    def __init__(self, interface: Mapping[str, Any], known: Mapping[str, list[str]]) -> None:
        self._known = known
        self._shapes = Shapes(interface["components"]["schemas"], [one for ids in known.values() for one in ids])
        self.routes = [
            (method, path, operation)
            for path, methods in interface["paths"].items()
            for method, operation in methods.items()
            if not path.endswith("/events")
        ]

    def case(self) -> st.SearchStrategy[Case]:
        """One request."""
        return st.composite(self._case)()

    def _case(self, draw: st.DrawFn) -> Case:
        # Routes that take a body read much more than the others.
        bodied = [route for route in self.routes if "requestBody" in route[2]]
        method, path, operation = draw(st.sampled_from([*self.routes, *bodied, *bodied]))
        address, query = path, []
        for parameter in operation.get("parameters", ()):
            name = parameter["name"]
            if parameter["in"] == "path":
                value = draw(st.sampled_from(self._known[name])) if draw(st.integers(0, 9)) else draw(texts)
                address = address.replace(f"{{{name}}}", quote(_utf8(value), safe="") or "%20")
            elif parameter["in"] == "query" and (parameter.get("required") or draw(st.booleans())):
                query += [(name, _utf8(text)) for text in self._query(draw, name, parameter)]
        content, headers = self._body(draw, operation)
        return Case(method, path, address + ("?" + urlencode(query) if query else ""), content, headers)

    def _query(self, draw: st.DrawFn, name: str, parameter: Mapping[str, Any]) -> list[str]:
        if name in self._known and draw(st.booleans()):
            return [draw(st.sampled_from(self._known[name]))]
        value = self._shapes.draw(draw, parameter["schema"], wild=4)
        return [
            one if isinstance(one, str) else json.dumps(one) for one in (value if isinstance(value, list) else [value])
        ]

    def _body(self, draw: st.DrawFn, operation: Mapping[str, Any]) -> tuple[bytes | None, dict[str, str]]:
        contents = operation.get("requestBody", {}).get("content", {})
        if not contents:
            return (
                (None, {})
                if draw(st.integers(0, 9))
                else (draw(st.sampled_from(RAW)), {"content-type": "application/json"})
            )
        media = draw(st.sampled_from(sorted(contents)))
        headers = {
            "content-type": draw(texts).encode("ascii", "ignore").decode().strip()
            if draw(st.integers(0, 29)) == 0
            else media
        }
        headers = {name: "".join(c for c in value if c.isprintable()) for name, value in headers.items()}
        if draw(st.integers(0, 14)) == 0:
            return draw(st.sampled_from(RAW)), headers
        if len(contents) > 1:
            return draw(FILES[media]()), headers
        document = self._shapes.draw(draw, contents[media]["schema"], wild=draw(st.sampled_from([0, 4, 40])))
        if isinstance(document, dict) and "urdf" in document:
            document["urdf"] = draw(urdf())
        return json.dumps(document).encode(), headers


def _utf8(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")
