"""The HTTP interface as text, a line for each route, parameter, body, answer, model, field and error code.

A reviewer reads a change of the contract in it, and `python -m tools.contract` reads the document of OpenAPI back: nothing of
it is lost. A schema is its type or the model's name and what bounds it, as OpenAPI names that: ``[number](maxItems 3) | null``.
``[A, B]`` are places of a list, ``{A}`` are values by name, ``(A | B)`` is anyOf, ``<A | B>`` is oneOf, by ``kind`` where the
kind of each stands before it. What does not fit a line of this form stands there as JSON.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

Document = dict[str, Any]

SNAPSHOT = Path(__file__).resolve().parents[2] / "tests/contract/openapi.txt"  # test_openapi.py holds it
REFERENCE = "#/components/schemas/"
TYPES = ("string", "integer", "number", "boolean", "null", "object")
DECODER = json.JSONDecoder()
WORD = re.compile(r"[\w$.-]+")
METHODS = "GET|PUT|POST|DELETE|OPTIONS|HEAD|PATCH|TRACE"
ROUTE = re.compile(
    rf"(?P<method>{METHODS}) (?P<path>/\S*?)"
    r"(?: (?P<place>query|path|header|cookie) (?P<name>\S+?)| body (?P<body>\S+?)| (?P<statuses>\d\w\w(?:, \d\w\w)*)"
    r"(?: (?P<media>\S+?))?)?:(?: (?P<said>.*))?"
)
FIELD = re.compile(r"(?P<model>\w+)(?:\.(?P<field>\S+?))?: (?P<said>.*)")
RAW = "json "


def interface_text(document: Document, codes: Mapping[str, tuple[int, str]]) -> str:
    """Return the lines of a document of OpenAPI and of the error codes: status and title of each."""
    lines = [f"{key}: {_json(document[key])}" for key in sorted(document) if key not in ("paths", "components")]
    parts = document["components"]
    lines += [f"components.{key}: {_json(parts[key])}" for key in sorted(parts) if key != "schemas"]
    for path, methods in sorted(document["paths"].items()):
        for method, operation in sorted(methods.items()):
            place = f"{method.upper()} {path}"
            own = [*_operation_lines(place, operation)]
            lines += (
                own if _is_read_back(own, "paths", path, method, operation) else [f"{place}: {RAW}{_json(operation)}"]
            )
    for name, schema in sorted(parts["schemas"].items()):
        own = [*_model_lines(name, schema)]
        lines += own if _is_read_back(own, "components", "schemas", name, schema) else [f"{name}: {RAW}{_json(schema)}"]
    lines += [f"error {code}: {status} {title}" for code, (status, title) in sorted(codes.items())]
    return "\n".join(lines) + "\n"


def interface_document(text: str) -> Document:
    """Return the document of OpenAPI that the lines say; required fields are by name."""
    document: Document = {"paths": {}, "components": {"schemas": {}}}
    for line in text.splitlines():
        try:
            _read_line(document, line)
        except (ValueError, IndexError, AttributeError) as error:
            raise ValueError(f"This line is no part of an interface: {line[:200]}") from error
    for schema in document["components"]["schemas"].values():
        if "required" in schema:
            schema["required"].sort()
    return document


def promised_interface() -> Document:
    """Return the document of OpenAPI that the snapshot in the repository says."""
    return interface_document(SNAPSHOT.read_text(encoding="utf-8"))


def _json(value: Any) -> str:
    return json.dumps(value, ensure_ascii=False, sort_keys=True)


def _is_read_back(lines: Sequence[str], part: str, first: str, second: str, said: Any) -> bool:
    try:
        return bool(interface_document("\n".join(lines))[part][first][second] == with_sorted_required(said))
    except (KeyError, ValueError):
        return False


def with_sorted_required(schema: Document) -> Document:
    """Return a schema whose required fields are by name: their order is no part of the contract."""
    return {**schema, "required": sorted(schema["required"])} if "required" in schema else schema


def _operation_lines(place: str, operation: Document) -> Iterator[str]:
    said = {
        key: one
        for key, one in operation.items()
        if key not in ("description", "parameters", "requestBody", "responses")
    }
    yield f"{place}: {_pairs(said)}{_text(operation)}"
    for one in operation.get("parameters", ()):
        schema = dict(one["schema"])
        if "description" in one and schema.get("description") == one["description"]:
            schema.pop("description")
        yield f"{place} {one['in']} {one['name']}: {_field(one['name'], schema, one['required'], one)}"
    body = operation.get("requestBody", {})
    for media, one in sorted(body.get("content", {}).items()):
        yield f"{place} body {media}: {_whether_required(body.get('required'))}{_schema(one['schema'])}"
    same: dict[str, list[str]] = {}
    for status, answer in sorted(operation["responses"].items()):
        same.setdefault(_json(answer), []).append(status)
    for statuses in same.values():
        answer = operation["responses"][statuses[0]]
        for kind, content in sorted(answer.get("content", {"": {}}).items()):
            form = f" {_schema(content['schema'])}" if "schema" in content else ""
            yield f"{place} {', '.join(statuses)}{f' {kind}' if kind else ''}:{form}{_text(answer)}"


def _model_lines(name: str, schema: Document) -> Iterator[str]:
    own = {key: one for key, one in schema.items() if key not in ("properties", "required", "description")}
    if own.get("title") == name:
        own.pop("title")
    yield f"{name}: {_schema(own)}{_text(schema)}"
    for field, one in sorted(schema.get("properties", {}).items()):
        yield f"{name}.{field}: {_field(field, one, field in schema.get('required', ()), one)}"


def _field(name: str, schema: Document, required: bool, described: Document) -> str:
    """Schema, default and description of a field or parameter, whose title follows from its name."""
    own = {key: one for key, one in schema.items() if key not in ("default", "description")}
    if own.get("title") == _title(name, own):
        own.pop("title", None)
    else:
        own.setdefault("title", None)
    default = f" = {_json(schema['default'])}" if "default" in schema else ""
    return f"{_whether_required(required)}{_schema(own)}{default}{_text(described)}"


def _title(name: str, schema: Document) -> str | None:
    """The title that pydantic gives a field: its name in words, and none where the field is of a model."""
    is_model = any("$ref" in one for one in (schema, *schema.get("anyOf", ())))
    return None if is_model else name.replace("-" if "-" in name else "_", "-" if "-" in name else " ").title()


def _whether_required(required: Any) -> str:
    return "required " if required else ""


def _text(said: Document) -> str:
    text = said.get("description")
    return "" if text is None else " -- " + text.replace("\\", "\\\\").replace("\n", "\\n")


def _pairs(said: Document) -> str:
    return ", ".join(f"{key} {_json(one)}" for key, one in sorted(said.items()))


def _schema(schema: Document) -> str:
    return (
        " | ".join(map(_one, schema["anyOf"]))
        if list(schema) == ["anyOf"] and len(schema["anyOf"]) > 1
        else _one(schema)
    )


def _one(schema: Document) -> str:
    """One of the forms of a value: its head, then in parentheses what else is said of it."""
    rest = dict(schema)
    head = _head(rest)
    return f"{head}({_pairs(rest)})" if rest else head


def _head(rest: Document) -> str:
    """What kind of value it is; takes from ``rest`` what it says."""
    if "$ref" in rest:
        return str(rest.pop("$ref")).removeprefix(REFERENCE)
    if "anyOf" in rest:
        return f"({' | '.join(map(_one, rest.pop('anyOf')))})"
    if "oneOf" in rest:
        return _one_of(rest)
    kind = rest.pop("type", "any")
    if kind == "array":
        places = rest.get("prefixItems", ())
        inner = [rest.pop("items")] if "items" in rest else rest.pop("prefixItems") if len(places) > 1 else []
        return f"[{', '.join(map(_schema, inner))}]"
    if kind == "object" and isinstance(rest.get("additionalProperties"), dict):
        return f"{{{_schema(rest.pop('additionalProperties'))}}}"
    return str(kind)


def _one_of(rest: Document) -> str:
    variants, by = rest.pop("oneOf"), rest.get("discriminator", {"mapping": {}})
    kinds = {reference: kind for kind, reference in by["mapping"].items()}
    if [{"$ref": one} for one in sorted(kinds)] != sorted(variants, key=_json):
        return f"<{' | '.join(map(_one, variants))}>"
    del rest["discriminator"]
    by_kind = [f"{kinds[one['$ref']]} {_one(one)}" for one in variants]
    return f"<{by['propertyName']}: {' | '.join(by_kind)}>"


def _read_line(document: Document, line: str) -> None:
    schemas = document["components"]["schemas"]
    if line.startswith("error "):
        return
    if route := ROUTE.fullmatch(line):
        operation = document["paths"].setdefault(route["path"], {}).setdefault(route["method"].lower(), {})
        _read_route(operation, route, route["said"] or "")
        return
    found = FIELD.fullmatch(line)
    assert found is not None
    model, field, said = found["model"], found["field"], found["said"]
    if model == "components":
        document["components"][field] = json.loads(said)
    elif field is not None:
        schema, required = _Reader(said).field(field)
        schemas[model].setdefault("properties", {})[field] = schema
        if required:
            schemas[model].setdefault("required", []).append(field)
    elif model[0].isupper():
        is_raw = said.startswith(RAW)
        schemas[model] = (
            json.loads(said[len(RAW) :]) if is_raw else {"title": model, **_Reader(said).described_schema()}
        )
    else:
        document[model] = json.loads(said)


def _read_route(operation: Document, route: re.Match[str], said: str) -> None:
    if route["place"]:
        schema, required = _Reader(said).field(route["name"])
        described = {"description": schema["description"]} if "description" in schema else {}
        parameter = {"name": route["name"], "in": route["place"], "required": required, "schema": schema, **described}
        operation.setdefault("parameters", []).append(parameter)
    elif route["body"]:
        reader = _Reader(said)
        said_required = {"required": True} if reader.takes("required ") else {}
        body = operation.setdefault("requestBody", {"content": {}, **said_required})
        body["content"][route["body"]] = {"schema": reader.schema()}
    elif route["statuses"]:
        for status in route["statuses"].split(", "):
            answer = operation.setdefault("responses", {}).setdefault(status, {})
            _read_answer(answer, route["media"], f" {said}" if said else "")
    elif said.startswith(RAW):
        operation |= json.loads(said[len(RAW) :])
    else:
        reader = _Reader(said)
        operation |= reader.pairs() | reader.description()


def _read_answer(answer: Document, media: str | None, said: str) -> None:
    reader = _Reader(said)
    schema = {} if not said or said.startswith(" -- ") else {"schema": reader.after(" ").schema()}
    answer |= reader.description()
    if media:
        answer.setdefault("content", {})[media] = schema


class _Reader:
    """Reads what stands after the place of a line, from left to right."""

    def __init__(self, text: str) -> None:
        self.text, self.at = text, 0

    def takes(self, word: str) -> bool:
        """Whether this stands here; it is passed then."""
        found = self.text.startswith(word, self.at)
        self.at += len(word) if found else 0
        return found

    def after(self, word: str) -> _Reader:
        """Pass what must stand here."""
        if not self.takes(word):
            raise ValueError(f"{word!r} is missing at {self.text[self.at : self.at + 40]!r}")
        return self

    def field(self, name: str) -> tuple[Document, bool]:
        """Schema of a field or parameter with its title, default and description, and whether it is required."""
        required = self.takes("required ")
        schema = self.schema()
        title = schema.pop("title", _title(name, schema))
        default = {"default": self.json()} if self.takes(" = ") else {}
        return {**schema, **({"title": title} if title is not None else {}), **default, **self.description()}, required

    def described_schema(self) -> Document:
        """A schema and its description."""
        return {**self.schema(), **self.description()}

    def description(self) -> Document:
        """The rest of the line, if it is a description; nothing else may be left."""
        if not self.takes(" -- "):
            if self.at < len(self.text):
                raise ValueError(f"{self.text[self.at : self.at + 40]!r} is left")
            return {}
        words = re.sub(r"\\(.)", lambda found: {"n": "\n"}.get(found[1], found[1]), self.text[self.at :])
        self.at = len(self.text)
        return {"description": words}

    def schema(self) -> Document:
        """A schema: one form, or several of which any may be."""
        found = self.separated(self.one, " | ")
        return {"anyOf": found} if len(found) > 1 else found[0]

    def one(self) -> Document:
        """One form: its head and what is said of it in parentheses."""
        head = self.head()
        if not self.takes("("):
            return head
        said = self.pairs()
        self.after(")")
        return {**head, **said}

    def head(self) -> Document:
        """What kind of value it is."""
        if self.takes("["):
            if self.takes("]"):
                return {"type": "array"}
            places = self.separated(self.schema, ", ")
            self.after("]")
            return {"type": "array", **({"prefixItems": places} if len(places) > 1 else {"items": places[0]})}
        if self.takes("{"):
            values = self.schema()
            self.after("}")
            return {"type": "object", "additionalProperties": values}
        if self.takes("("):
            found = self.separated(self.one, " | ")
            self.after(")")
            return {"anyOf": found}
        if self.takes("<"):
            return self.one_of()
        word = self.word()
        return {} if word == "any" else {"type": word} if word in TYPES else {"$ref": f"{REFERENCE}{word}"}

    def one_of(self) -> Document:
        """Forms of which exactly one may be, by kind where the kinds are said."""
        by = re.compile(r"(\w+): ").match(self.text, self.at)
        kinds = []
        if by:
            self.at = by.end()

        def variant() -> Document:
            if by:
                kinds.append(self.word())
                self.after(" ")
            return self.one()

        found = self.separated(variant, " | ")
        self.after(">")
        if not by:
            return {"oneOf": found}
        mapping = {kind: one["$ref"] for kind, one in zip(kinds, found, strict=True)}
        return {"oneOf": found, "discriminator": {"propertyName": by[1], "mapping": mapping}}

    def separated(self, part: Callable[[], Document], separator: str) -> list[Document]:
        """Parts with a separator between."""
        found = [part()]
        while self.takes(separator):
            found.append(part())
        return found

    def pairs(self) -> Document:
        """Names with their values."""
        found = {}
        while True:
            name = self.word()
            found[name] = self.after(" ").json()
            if not self.takes(", "):
                return found

    def json(self) -> Any:
        """A value of JSON."""
        value, self.at = DECODER.raw_decode(self.text, self.at)
        return value

    def word(self) -> str:
        """A name."""
        found = WORD.match(self.text, self.at)
        if found is None:
            raise ValueError(f"a name is missing at {self.text[self.at : self.at + 40]!r}")
        self.at = found.end()
        return found[0]
