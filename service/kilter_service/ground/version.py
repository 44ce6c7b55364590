"""Which build of Kilter this is."""

from __future__ import annotations

from functools import cache
from importlib.metadata import PackageNotFoundError, version

SOURCE_TREE = "0.2.0+source"


@cache
def code_version() -> str:
    """Return the version of the installed distribution, or that of a source tree that is not installed."""
    try:
        return version("kilter")
    except PackageNotFoundError:
        return SOURCE_TREE
