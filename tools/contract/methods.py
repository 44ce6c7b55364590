"""`service/kilter_service/contract/methods.py` from the core's methods: the API process must say what they are without numpy."""

from __future__ import annotations

from kilter_core.identify.methods import ESTIMATORS

HEAD = '''"""The methods of an identification, made from core/kilter_core/identify/methods.py by `make contract`: change them there."""

from __future__ import annotations

from typing import Literal

'''


def methods_module() -> str:
    """Return the module's text."""
    return f"{HEAD}MethodName = Literal[{', '.join(map(repr, ESTIMATORS))}]\n"
