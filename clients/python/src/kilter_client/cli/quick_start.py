"""What a command would load and does not need: 0.2 s of processor time of the 0.4 s that listing versions took.

Both parts depend on the internals of typer and httpx. Where these differ they change nothing.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, get_origin


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
