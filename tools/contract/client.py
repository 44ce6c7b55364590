"""What the Python client has of the interface: types of answers, and the help of the options of jobs.

It is made from the snapshot of the interface alone, so that a wheel of the client can be built where nothing of the server is
installed: its build (clients/python/hatch_build.py) calls ``write_client``. Git does not hold it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tools.contract.client_types import client_modules, kinds_of_job
from tools.contract.interface import promised_interface

CLIENT = Path(__file__).resolve().parents[2] / "clients/python/src/kilter_client"
TYPED, LISTS = CLIENT / "typed", CLIENT / "cli/texts/lists.json"


def client_files() -> dict[Path, str]:
    """Return the text of each module of ``kilter_client.typed`` that is made."""
    interface = promised_interface()
    texts = {**client_modules(interface), "option_texts": _option_texts(interface)}
    return {TYPED / f"{module}.py": text for module, text in texts.items()}


def write_client() -> None:
    """Write the modules that are missing or not what the interface says."""
    for path, text in client_files().items():
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def _option_texts(interface: Mapping[str, Any]) -> str:
    """The module with what a command must know of each kind of job."""
    schemas = interface["components"]["schemas"]
    needs = {row["id"]: row["needs_campaigns"] for row in json.loads(LISTS.read_text(encoding="utf-8"))["kinds"]}
    lines = ['"""Kinds of jobs and their options, made from the interface by `make contract`: change it there."""\n']
    lines.append("from __future__ import annotations\n\nfrom kilter_client.results.record import Kind\n")
    kinds = []
    for kind, job in kinds_of_job(interface).items():
        stem = job.removesuffix("Job")
        options = schemas[f"{stem}Options"]["properties"]
        lines.append(f"{kind.upper()} = {{")
        lines += [f"    {name!r}: {plain_text(schema)!r}," for name, schema in options.items()]
        lines.append("}")
        forms = {name: _form(schema) for name, schema in options.items()}
        summary = schemas[f"New{stem}Job"]["description"]
        kinds.append(f"    {kind!r}: Kind({summary!r}, {needs[kind]!r}, {kind.upper()}, {forms!r}),")
    return "\n".join([*lines, "KINDS = {", *kinds, "}"]) + "\n"


def _form(schema: Mapping[str, Any]) -> str:
    """What a command takes for an option: a form of ``Kind``, or its choices with bars between."""
    parts = [part for part in schema.get("anyOf", [schema]) if part.get("type") != "null"]
    if len(parts) != 1:
        return "json"
    kind, values = parts[0].get("type"), parts[0].get("enum", [parts[0]["const"]] if "const" in parts[0] else [])
    if values:
        return "|".join(values) if all(isinstance(one, str) for one in values) else "json"
    items = parts[0].get("items", {})
    if kind == "array" and items.get("type") == "string":
        return "names"
    return {"boolean": "flag", "integer": "integer", "number": "number", "string": "text"}.get(str(kind), "json")


def plain_text(schema: Mapping[str, Any]) -> str:
    """Return a description without the marks of a page, for where an option is not given instead of null."""
    return re.sub(r"\b(null|empty):", "left out:", str(schema["description"]).replace("`", ""))


if __name__ == "__main__":
    write_client()
