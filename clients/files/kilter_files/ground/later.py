"""Packages that are imported when they are first used: a start does not wait for them, and runs where they are missing.

What is imported from here stands in the module's namespace as a module that was imported by itself would:
``from kilter_files.ground.later import np``. Where a package is missing, its first use raises ``ImportError``.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__all__ = ["csv", "interpolate", "mujoco", "np", "pa", "parquet", "pc", "special", "stats", "transform"]


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


if TYPE_CHECKING:
    import mujoco
    import numpy as np
    import pyarrow as pa
    import pyarrow.compute as pc
    from pyarrow import csv, parquet
    from scipy import interpolate, special, stats
    from scipy.spatial import transform
else:
    csv, interpolate, mujoco, np, pa, parquet, pc, special, stats, transform = map(
        Later,
        (
            "pyarrow.csv",
            "scipy.interpolate",
            "mujoco",
            "numpy",
            "pyarrow",
            "pyarrow.parquet",
            "pyarrow.compute",
            "scipy.special",
            "scipy.stats",
            "scipy.spatial.transform",
        ),
    )
