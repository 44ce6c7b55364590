"""Every frame of a recording with a joint log by time: the clocks, and the checks before a row is sent."""

from __future__ import annotations

from kilter_files.match.clock_checks import Checks
from kilter_files.match.clocks import Pieces, match_pieces
from kilter_files.match.dwells import thin
from kilter_files.match.matching import refuse_jumps
from kilter_files.match.pair_checks import refuse_knocks_of_frames, refuse_wrong_frames
from kilter_files.tables.joint_log import JointLog
from kilter_files.tables.recording import Recording


def match_frames(recording: Recording, log: JointLog, checks: Checks) -> tuple[Pieces, list[str]]:
    """Match the clocks of a recording whose every frame is to be sent; return warnings too.

    Raises:
        FileError: clocks that jump, markers or a body that were knocked, joints that belong to other markers.

    """
    refuse_jumps(recording)
    thinned = thin(recording)
    warnings = refuse_knocks_of_frames(recording, thinned, checks)
    pieces, told = match_pieces(recording.path, thinned, log, checks)
    warnings += told
    return pieces, warnings + refuse_wrong_frames(recording.path, log, thinned, pieces.log_time, checks)
