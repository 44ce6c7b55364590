"""Files of measurements, made ready for upload.

A name is imported when it is first asked for: a start does not wait for the readers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from kilter_files.ready import draft, inspect, prepare, preset_of, read_joints
    from kilter_files.tables.table import Prepared, Table

    DEVICES: Mapping[str, Callable[[Path], Table]]

__all__ = ["DEVICES", "Prepared", "draft", "inspect", "prepare", "preset_of", "read_joints"]


def __getattr__(name: str) -> Any:
    """``DEVICES``: the reader of each device's files, by name; else what one of the modules calls so."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    ready = import_module("kilter_files.ready")
    return ready.devices() if name == "DEVICES" else getattr(ready, name)
