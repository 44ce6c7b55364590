"""Packages that are imported when they are first used: a start does not wait for them, and runs where they are missing.

What is imported from here stands in the module's namespace as a module that was imported by itself would:
``from kilter_files.ground.later import np``. Where a package is missing, its first use raises ``ImportError``; a reader
whose package is of an extra calls :func:`need` first, which says what installs it.
"""

from __future__ import annotations

import builtins
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from threading import RLock
from types import SimpleNamespace
from typing import Any

from kilter_files.ground.errors import MissingPackageError


class Later:
    """Stands for a module that is imported when one of its names is asked for.

    It asks the module each time and keeps none of its names; unlike ``importlib.util.LazyLoader`` it never stands among the
    loaded modules half made, where another thread could find it.
    """

    def __init__(self, name: str) -> None:
        """Stand for the module ``name``."""
        self._name = name
        self._module: object = self  # nothing yet

    def __getattr__(self, name: str) -> Any:
        """Import the module, and return what it calls so."""
        if name.startswith("__"):  # what asks whether this is a module, a class or a wrapper imports nothing
            raise AttributeError(name)
        if sys.modules.get(self._name) is not self._module:  # import_module takes ten times as long to find it loaded
            self._module = import_module(self._name)
        return getattr(self._module, name)


_ONE_BLOCK = RLock()


@contextmanager
def later(module: str) -> Iterator[None]:
    """Import each module that the block names at its first use: ``with later(__name__):`` and the imports.

    It is said once, for whoever runs it and for whoever checks types. Only the statements of ``module`` wait: what other
    threads import meanwhile they have at once.
    """

    def import_lazily(name: str, *how: Any, **further: Any) -> Any:
        if not how or not how[0] or how[0].get("__name__") != module:
            return at_once(name, *how, **further)
        wanted = how[2]
        if wanted:  # from a.b import c: whose attribute c is taken
            return SimpleNamespace(**{one: Later(f"{name}.{one}") for one in wanted})
        it: Any = Later(name)  # import a.b as c: whose attribute b is taken
        for part in reversed(name.split(".")[1:]):
            it = SimpleNamespace(**{part: it})
        return it

    with _ONE_BLOCK:
        at_once = builtins.__import__
        builtins.__import__ = import_lazily
        try:
            yield
        finally:
            builtins.__import__ = at_once


def need(what: str, package: str, *modules: str, install: str = "", instead: str = "") -> Any:
    """Import what an extra brings before its first use, and return the last of its modules.

    Args:
        what: who needs it, with the verb: ``a.xlsx: Workbooks (.xlsx) need``.
        package: as it is called where it is had from.
        *modules: what is imported, if not the package by its own name.
        install: what the command that installs it names, if not the package.
        instead: what one can do without it: ``save the sheet as CSV``.

    Raises:
        MissingPackageError: it is not installed; the command that installs it is named.

    """
    try:
        return [import_module(module) for module in modules or (package,)][-1]
    except ImportError as error:
        remedy = f"Install it with: pip install {install or package}{f', or {instead}.' if instead else ''}"
        raise MissingPackageError(f"{what} {package}. {remedy}", package=package) from error


with later(__name__):
    import mujoco
    import numpy as np
    import pyarrow as pa
    import pyarrow.compute as pc
    import pypdfium2
    import yaml
    from PIL import Image, ImageOps
    from pyarrow import csv, parquet
    from rosbags import rosbag1, rosbag2, typesys
    from scipy import interpolate, special
    from scipy.spatial import transform
