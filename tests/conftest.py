"""What tests of every folder share."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# Set before numpy is imported: its threads make small fits ten times slower on two busy cores.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A first call loads compiled code, and the machine may be busy: no test fails by the clock.
settings.register_profile("kilter", deadline=None)
settings.load_profile("kilter")

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real measurements, which is not part of this repository."""
    folder = Path(os.environ.get("KILTER_SHARED_DATA", REPOSITORY.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"real measurements not found in {folder}: set KILTER_SHARED_DATA to their folder")
    return folder


@pytest.fixture
def kilterd() -> Iterator[Callable[[list[str]], None]]:
    """The command of the server, in this process; what it sets up for its log lines ends with the test."""
    from kilter_service.__main__ import main

    yield main
    for handler in [one for one in logging.root.handlers if type(one) is logging.StreamHandler]:
        logging.root.removeHandler(handler)
    logging.getLogger("kilter.access").disabled = True
