"""How a failure is logged: in one line where the database or its disk says what is wrong, and once until it works again."""

from __future__ import annotations

import logging

from kilter_files.ground.later import later

with later(__name__):
    from kilter_service.ground.db import failures


def log_failure(log: logging.Logger, error: Exception, message: str, *arguments: object) -> None:
    """Log a sentence with what the database or its disk says; only what Kilter does not know has its traceback."""
    known = failures.in_words(error)
    if known is not None and (known is error or known.code in failures.CODES):
        log.error(f"{message}: %s", *arguments, known.message)
    else:
        log.error(message, *arguments, exc_info=error)


class Failing:
    """Something that is tried again and again: that it fails is logged once, until it has worked again."""

    def __init__(self, log: logging.Logger, message: str, *arguments: object) -> None:
        self._log, self._message, self._arguments = log, message, arguments
        self._known = False

    def report_failure(self, error: Exception) -> None:
        """Say that it failed, and why."""
        if not self._known:
            self._known = True
            log_failure(self._log, error, self._message, *self._arguments)

    def report_success(self) -> None:
        """Note that it works."""
        self._known = False
