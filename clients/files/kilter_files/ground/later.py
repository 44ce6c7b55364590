"""Packages that are imported when they are first used: a start does not wait for them, and runs where they are missing.

What is imported from here stands in the module's namespace as a module that was imported by itself would:
``from kilter_files.ground.later import np``. Where a package is missing, its first use raises ``ImportError``; a reader
whose package is of an extra calls :func:`need` first, which says what installs it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from kilter_files.ground.errors import MissingPackageError

__all__ = [
    "Image",
    "ImageOps",
    "csv",
    "interpolate",
    "mujoco",
    "need",
    "np",
    "pa",
    "parquet",
    "pc",
    "pypdfium2",
    "rosbag1",
    "rosbag2",
    "special",
    "stats",
    "transform",
    "typesys",
    "yaml",
]


class Later:
    """Stands for a module that is imported when one of its names is asked for.

    It asks the module each time and keeps nothing; unlike ``importlib.util.LazyLoader`` it never stands among the loaded
    modules half made, where another thread could find it.
    """

    def __init__(self, name: str) -> None:
        """Stand for the module ``name``."""
        self._name = name

    def __getattr__(self, name: str) -> Any:
        """Import the module, and return what it calls so."""
        if name.startswith("__"):  # what asks whether this is a module, a class or a wrapper imports nothing
            raise AttributeError(name)
        return getattr(import_module(self._name), name)


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


if TYPE_CHECKING:
    import mujoco
    import numpy as np
    import pyarrow as pa
    import pyarrow.compute as pc
    import pypdfium2
    import yaml
    from PIL import Image, ImageOps
    from pyarrow import csv, parquet
    from rosbags import rosbag1, rosbag2, typesys
    from scipy import interpolate, special, stats
    from scipy.spatial import transform
else:
    csv = Later("pyarrow.csv")
    Image = Later("PIL.Image")
    ImageOps = Later("PIL.ImageOps")
    interpolate = Later("scipy.interpolate")
    mujoco = Later("mujoco")
    np = Later("numpy")
    pa = Later("pyarrow")
    parquet = Later("pyarrow.parquet")
    pc = Later("pyarrow.compute")
    pypdfium2 = Later("pypdfium2")
    rosbag1 = Later("rosbags.rosbag1")
    rosbag2 = Later("rosbags.rosbag2")
    special = Later("scipy.special")
    stats = Later("scipy.stats")
    transform = Later("scipy.spatial.transform")
    typesys = Later("rosbags.typesys")
    yaml = Later("yaml")
