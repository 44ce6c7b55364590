"""What may be in the job engine's database: JSON, never a pickle.

DBOS writes pickles by default and, whatever serializer it is given, loads one wherever a row says ``py_pickle``. Loading a
pickle runs the commands it names, so whoever can write to the jobs database could run commands as the worker.
"""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dbos import Serializer

REFUSAL = "A row of the jobs database holds a pickle, which could run commands: Kilter reads JSON only."


class ForeignRowError(Exception):
    """A row of the jobs database in a format that Kilter does not read."""


def json_only() -> Serializer:
    """Return the serializer to give to DBOS, after taking pickle away from it in this process."""
    from dbos._serialization import DBOSPortableJSON, DefaultSerializer

    # DBOS picks this class by the row, not by its configuration; there is no option to leave it out.
    DefaultSerializer.deserialize = _refuse  # type: ignore[method-assign, assignment]
    DefaultSerializer.serialize = _describe  # type: ignore[method-assign, assignment]
    return DBOSPortableJSON


def _refuse(_self: Any, _text: str) -> Any:
    raise ForeignRowError(REFUSAL)


def _describe(_self: Any, value: Any) -> str:
    """Write what DBOS wants to note in a row that says ``py_pickle`` (why it failed); nobody loads it."""
    return json.dumps(str(value))
