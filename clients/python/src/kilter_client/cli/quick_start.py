"""What a command would load and does not need: 0.2 s of processor time of the 0.4 s that listing versions took.

Both parts depend on the internals of typer and httpx. Where these differ they change nothing.

``kilter --version``: the release of this command, and of the server where one answers.
"""

from __future__ import annotations

import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, get_origin

from kilter_client.cli.terminal.output import emit, print_line
from kilter_client.errors import KilterError
from kilter_client.requests.connection import Connection, locate
from kilter_client.requests.steps import Document, Request, read


def without_httpx_command() -> None:
    """Keep httpx from loading its own command line, which takes click, pygments and half of rich with it."""
    if "httpx" in sys.modules or "httpx._main" in sys.modules:
        return
    stand_in = ModuleType("httpx._main")
    stand_in.main = _nothing  # type: ignore[attr-defined]
    sys.modules["httpx._main"] = stand_in


def _nothing() -> None:
    """Stand for httpx's command line."""


def with_quick_values() -> None:
    """Let texts, paths and choices through without pydantic, which typer loads to look at any value, even at none."""
    try:
        from typer import core
        from typer._coercion import RuntimeParam, TypeDescriptor, build_runtime_param
        from typer._param_types import coerce_cli_path
    except ImportError:  # another release of typer, which looks at values in its own way
        return
    if getattr(core, "build_runtime_param", None) is not build_runtime_param:  # done already, or made otherwise
        return

    class Quick(RuntimeParam):
        """Values that are what they should be as they stand; all others are typer's."""

        def _coerce_value(self, value: Any, param: Any, ctx: Any) -> Any:
            wanted: Any = self.annotation
            origin: Any = get_origin(wanted)
            if wanted is str and isinstance(value, str):
                return value
            if wanted == list[str] and all(isinstance(one, str) for one in value):
                return list(value)
            if wanted is Path and isinstance(value, str):
                return coerce_cli_path(Path(value), self.parameter_info, path_type=Path, param=param, ctx=ctx)
            if origin is Literal and value in wanted.__args__:
                return value
            if isinstance(wanted, type) and type(value) is wanted:  # a default
                return value
            return build_runtime_param(param.type_descriptor)._coerce_value(value, param=param, ctx=ctx)

    def quick(described: TypeDescriptor) -> RuntimeParam:
        if described.file_annotation is not None or described.parameter_info.parser is not None:
            return build_runtime_param(described)
        return Quick(parameter_info=described.parameter_info, annotation=described.annotation)

    vars(core)["build_runtime_param"] = quick


PATIENCE_S = 3.0
SOURCE_TREE = "0.2.0+source"


def show_releases(as_json: bool) -> None:
    """Print both releases; without a server the reason why it has none."""
    document: Document = {"kilter": own_release(), "server": None, "url": None}
    try:
        place = locate()
        document["url"] = place.url
        connection = Connection(place)
        found = connection.run(read(Request("GET", "/v1/health/live", timeout_s=PATIENCE_S)))
        document["server"] = found.get("version")
        connection.close()
    except KilterError as error:
        document["problem"] = error.detail
    emit(document, as_json, _show)


def own_release() -> str:
    """Return the release of the installed client, or that of a source tree that is not installed."""
    try:
        return version("kilter-client")
    except PackageNotFoundError:
        return SOURCE_TREE


def _show(document: Document) -> None:
    print_line(f"kilter {document['kilter']}")
    if document["server"]:
        print_line(f"server {document['server']} at {document['url']}")
    else:
        print_line(f"no server: {document['problem']}")
