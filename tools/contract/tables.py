"""Tables and help of the options of jobs and effects, from the contract."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Iterator
from dataclasses import fields
from typing import Any

from kilter_core.effects import EFFECTS
from kilter_files.formats.registry import list_formats
from kilter_service.contract.jobs.registry import KINDS
from kilter_service.contract.wording import describe_schema
from tools.contract.client import plain_text
from tools.contract.interface import REFERENCE, Document, promised_interface

MARK = re.compile(r"(<!-- make contract: (?P<name>[\w -]+) -->\n).*?(<!-- end -->)", re.DOTALL)


def with_tables(page: str) -> str:
    """Return a page with what stands between its marks made anew."""
    return MARK.sub(lambda found: f"{found[1]}{_table(found['name'])}{found[3]}", page)


def made_page(source: str, text: str) -> str:
    """Return a page of the reference from its text, which has a mark for each table."""
    title, rest = text.split("\n", 1)
    return f"{title}\n\n<!-- Made from {source} by `make contract`: change it there. -->\n{with_tables(rest)}"


def _table(name: str) -> str:
    from tools.contract.commands import sections_of_commands, table_of_server  # the commands as they were just written

    if name == "effects":
        return "\n".join(_effect_rows()) + "\n"
    if name == "kinds":
        return "\n".join(_kind_rows()) + "\n"
    if name == "formats":
        return "\n".join(_format_rows()) + "\n"
    if name == "kilterd":
        return table_of_server()
    if name.startswith("commands of "):
        return sections_of_commands(name.removeprefix("commands of "))
    if name.startswith("routes of "):
        return "\n".join(_route_rows(name.removeprefix("routes of "))) + "\n"
    return "\n".join(_option_rows(name.removeprefix("options of "))) + "\n"


def _format_rows() -> Iterator[str]:
    yield "| `kilter` ... | format | endings | what |"
    yield "|---|---|---|---|"
    for use, name, endings, title in list_formats():
        yield f"| `{use}` | `{name}` | {', '.join(f'`{ending}`' for ending in endings)} | {_cell(title)} |"


def _route_rows(tag: str) -> Iterator[str]:
    document = promised_interface()
    yield "| route | role | does | query and body |"
    yield "|---|---|---|---|"
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            if tag in operation["tags"]:
                does = " ".join(operation["description"].replace("``", "`").split())
                takes = ", ".join(_taken(operation, document["components"]["schemas"]))
                yield f"| `{method.upper()} {path}` | {operation.get('x-kilter-role', 'none')} | {_cell(does)} | {takes} |"


def _taken(operation: Document, schemas: Document) -> Iterator[str]:
    for one in operation.get("parameters", []):
        if one["in"] == "query":
            choices = ", ".join(f"`{value}`" for value in one["schema"].get("enum", []))
            yield f"`?{one['name']}=`" + (f" ({choices})" if choices else "")
    for media, body in operation.get("requestBody", {}).get("content", {}).items():
        model = body["schema"].get("$ref", "").removeprefix(REFERENCE)
        yield from (f"`{name}`" for name in (schemas[model].get("properties", {}) if model else [media]))


def properties(kind: str) -> dict[str, Any]:
    """Return the schema of each option of a kind of job."""
    found: dict[str, Any] = KINDS[kind].options.model_json_schema()["properties"]
    return found


def _option_rows(kind: str) -> Iterator[str]:
    yield "| option | may be | left out | meaning |"
    yield "|---|---|---|---|"
    for name, schema in properties(kind).items():
        yield f"| `{name}` | {_may_be(schema)} | {_default(schema)} | {_cell(schema['description'])} |"


def _may_be(schema: dict[str, Any]) -> str:
    text = str(schema)
    if "AskedEffect" in text or "EffectDocument" in text or "clearance_tilt" in text:
        return "a list of [effects](effects.md)"
    named = re.search(r"#/\$defs/(\w+)", text)
    return _cell(describe_schema(schema) or (f"`{named[1]}`" if named else ""))


def _default(schema: dict[str, Any]) -> str:
    return "must be given" if "default" not in schema else f"`{json.dumps(schema['default'])}`"


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _kind_rows() -> Iterator[str]:
    yield "| kind | options |"
    yield "|---|---|"
    for kind in KINDS:
        names = ", ".join(f"`{name}`" for name in properties(kind))
        yield f"| [`{kind}`](job-options.md#{kind}) | {names} |"


def _effect_rows() -> Iterator[str]:
    rows: dict[tuple[str, str], list[str]] = {}
    for kind in EFFECTS.values():
        for one in fields(kind):
            if one.name != "joints" or kind.at_joints:
                rows.setdefault((one.name, one.metadata["text"]), []).append(kind.id)
    yield "| effect | option | meaning |"
    yield "|---|---|---|"
    for (name, text), ids in rows.items():
        yield f"| {'all at joints' if name == 'joints' else ', '.join(ids)} | `{name}` | {_cell(text)} |"


def with_help(kind: str, text: str) -> str:
    """Return a MATLAB function with the options of its job in its help."""
    head, rest = text.split("%   Further pairs are the job's options.", 1)
    after = "\n".join(line for line in rest.split("\n") if not line.startswith("%     "))
    lines = list(_help_lines(kind))
    first, body = after.split("\n", 1)
    return f"{head}%   Further pairs are the job's options.{first}\n" + "\n".join(lines) + f"\n{body}"


def _help_lines(kind: str) -> Iterator[str]:
    for name, schema in properties(kind).items():
        wrapped = textwrap.wrap(plain_text(schema), 90)
        yield f"%     {name:<20} {wrapped[0]}"
        yield from (f"%     {'':<20} {line}" for line in wrapped[1:])
