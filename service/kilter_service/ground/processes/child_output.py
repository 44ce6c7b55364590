"""What a process says goes on to where this one says its own; the last of it is kept for the message that it ended."""

from __future__ import annotations

import json
import sys
import threading
from typing import IO

LONGEST = 500
GRACE_S = 0.2  # children of the process may keep its output open


def _sentence(line: str) -> str:
    """What a line of a process says: of one as JSON its message, and of an error that nobody caught the error."""
    if not line.startswith("{"):
        return line.removeprefix("kilterd: ")
    try:
        said = json.loads(line)
        return str(said.get("exception", said["message"])).strip().splitlines()[-1]
    except (ValueError, KeyError, IndexError, AttributeError):
        return line


class ChildOutput:
    """Follows the output of one process after another, and knows the last line."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._line = ""
        self._thread: threading.Thread | None = None

    def follow(self, output: IO[bytes] | None) -> None:
        """Pass on what comes out until it ends."""
        assert output is not None
        self._line = ""
        self._thread = threading.Thread(
            target=self._forward_output, args=(output,), daemon=True, name=f"{self._name}-output"
        )
        self._thread.start()

    def last_line(self) -> str:
        """Return the last line, of a traceback its error, as far as the process said anything."""
        self.close()
        return self._line or "it said nothing"

    def close(self) -> None:
        """Wait until the output of a process that has ended is passed on."""
        if self._thread is not None:
            self._thread.join(GRACE_S)

    def _forward_output(self, output: IO[bytes]) -> None:
        with output:
            for line in output:
                text = line.decode(errors="replace")
                if text.strip():
                    self._line = _sentence(text.strip())[:LONGEST]
                try:
                    sys.stderr.write(text)
                    sys.stderr.flush()
                except (OSError, ValueError):
                    continue  # nobody reads this process any more; the other must not block for it
