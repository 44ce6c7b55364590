"""Drawn sheets that several tests look at; drawing one takes a second."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from kilter_files.rig.sheet.layout import Sheet, sheet_for

sys.path.insert(0, str(Path(__file__).parent))

Look = Callable[..., Path]


@pytest.fixture(scope="session")
def sheet() -> Sheet:
    """A small sheet: its pictures are small too."""
    return sheet_for(25)


@pytest.fixture(scope="session")
def paper(sheet: Sheet) -> tuple[NDArray[np.float64], float]:
    from paper import drawn

    return drawn(sheet)


@pytest.fixture(scope="session")
def scan(paper: tuple[NDArray[np.float64], float]) -> Image.Image:
    """A plain scan at 260 dpi."""
    from paper import View, seen

    return seen(*paper, View())
