"""The Python library of Kilter, by the name that a script writes: ``import kilter``.

``k = kilter.connect()`` finds the server; everything else is what ``kilter_client`` has.
"""

from __future__ import annotations

from kilter_client import *  # noqa: F403 - the names are listed in kilter_client.__all__
from kilter_client import __all__ as __all__
from kilter_client import __getattr__ as __getattr__
