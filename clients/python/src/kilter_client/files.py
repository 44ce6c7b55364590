"""Rooms that read and write files, each imported when they are first used: most commands and calls need none of them.

``from kilter_client.files import files_match`` stands for ``kilter_files.match``, whose face names what may be used of it.
"""

from __future__ import annotations

from kilter_files.ground.later import later

with later(__name__):
    from kilter_files import formats as files_formats
    from kilter_files import look as files_look
    from kilter_files import match as files_match
    from kilter_files import rig as files_rig
    from kilter_files import robots as files_robots
    from kilter_files import tables as files_tables
