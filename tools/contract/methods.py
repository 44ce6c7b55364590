"""The contract's module of methods, from the core's: the API process must say what they are without numpy."""

from __future__ import annotations

from kilter_core.identify.registry import METHODS

HEAD = '''"""The methods of an identification, made by `make contract` from core/kilter_core/identify/registry.py."""

from __future__ import annotations

from typing import Literal

'''


def methods_module() -> str:
    """Return the module's text."""
    return f"{HEAD}MethodName = Literal[{', '.join(map(repr, METHODS))}]\n"
