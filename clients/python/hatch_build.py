"""Makes the types of answers and the help of options before a wheel, an sdist or an editable install is built.

They are made from the interface that the repository promises. An sdist brings them: there is nothing to make them from.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class ClientTypes(BuildHookInterface[Any]):
    """Writes ``kilter_client.typed`` from the snapshot of the interface."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Write what is missing or old, where this is a checkout of the repository."""
        repository = Path(self.root).resolve().parents[1]
        if (repository / "tools/contract/client.py").is_file():
            sys.path.insert(0, str(repository))
            from tools.contract.client import write_client

            write_client()
            sys.path.remove(str(repository))
