"""The HTTP interface as the server describes it."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from kilter_service.ground.errors import PROBLEMS
from kilter_service.ground.settings import Settings
from kilter_service.run.app import create_app
from tools.contract.interface import Document, interface_text


def served_interface() -> Document:
    """Return the document of OpenAPI of a server without data; the version of the distribution is no part of the promise."""
    with TemporaryDirectory() as folder:
        found: dict[str, Any] = create_app(Settings(data=Path(folder))).openapi()
    found["info"]["version"] = "0"
    return found


def served_interface_text() -> str:
    """Return the text that the snapshot should have."""
    return interface_text(served_interface(), PROBLEMS)
