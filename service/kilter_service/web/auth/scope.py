"""A token that is limited to robots: what a path names must be of one of them, before the body is read.

Stores leave out what the caller may not see (`kilter_service.ground.caller`), so everything else is as unknown to such a token
as what does not exist: 404. The application says how what a path names is looked up: nothing here knows the features.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from kilter_service.ground.db import Database, Session

LookUp = Callable[[Session, str, str], None]


def check_path(database: Database, look_up: LookUp, named: Mapping[str, object]) -> None:
    """Look up what a path names, each by its name in paths and its value.

    Raises:
        ServiceError: it does not exist, or the caller may not see it.

    """
    with database.reading() as session:
        for name, value in named.items():
            look_up(session, name, str(value))
