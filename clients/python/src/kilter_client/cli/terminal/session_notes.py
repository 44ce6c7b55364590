"""Notes that a person reads once in a session of work: which ones were shown is kept in a file of the person's own."""

from __future__ import annotations

import hashlib
import json
import os
import time
from pathlib import Path

SESSION_S = 12 * 3600.0


def is_note_due(server: str, sentence: str) -> bool:
    """Return whether a note of a server was not shown in the last twelve hours, and remember that it is shown now.

    Another cause or another robot is another sentence. Where nothing can be remembered, a note is always due.
    """
    file, now = _file(), time.time()
    key = hashlib.sha256(f"{server} {sentence}".encode()).hexdigest()[:16]
    try:
        shown = {str(name): float(at) for name, at in json.loads(file.read_text()).items()}
    except (OSError, ValueError, TypeError, AttributeError):
        shown = {}
    recent = {name: at for name, at in shown.items() if 0.0 <= now - at < SESSION_S}
    if key in recent:
        return False
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps(recent | {key: now}))
    except OSError:
        pass
    return True


def _file() -> Path:
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "kilter" / "notes-shown.json"
