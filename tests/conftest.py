"""What tests of every folder share."""

from __future__ import annotations

import os
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
