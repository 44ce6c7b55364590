"""What ``kilter`` answers with ``--json``."""

from __future__ import annotations

import json
from typing import Any

import pytest

from kilter_client.cli import run


def document(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 0) -> dict[str, Any]:
    """Run a command that ends with ``code``, and read its document."""
    capsys.readouterr()
    found = run([*map(str, arguments), "--json"])
    out, err = capsys.readouterr()
    assert found == code, out + err
    answer: dict[str, Any] = json.loads(out)
    return answer
