"""The file in which a running server tells its clients on this machine where it is."""

from __future__ import annotations

import json
from pathlib import Path
from types import TracebackType
from typing import Any

from kilter_service.ground.files.private_files import private_folder


class ServerFile:
    """Writes the file when the server is ready, removes it when the server stops."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def write(self, document: dict[str, Any]) -> None:
        """Replace the file in one go, so that nobody reads half of it."""
        part = self._path.with_suffix(".part")
        part.write_text(json.dumps(document, indent=1), encoding="utf-8")
        part.replace(self._path)

    def __enter__(self) -> ServerFile:
        private_folder(self._path.parent)
        self._path.unlink(missing_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._path.unlink(missing_ok=True)
