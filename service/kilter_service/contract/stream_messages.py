"""What a message of the stream says beside its numbers, as docs/reference/stream.md tables it: kinds, flags and verdicts."""

from __future__ import annotations

from enum import IntEnum

MAX_AGE_NS = 50_000_000  # of a setpoint when it arrives


class Kind(IntEnum):
    """What a message carries."""

    POINT = 0
    CHUNK = 1
    TRAJECTORY = 2


class Flag(IntEnum):  # not IntFlag: its operators are Python, and nine of them took half the time of an answer
    """Low byte: what the sender adds. High byte: how the answer was made."""

    QD = 0x0001  # n velocities follow the positions
    QDD = 0x0002  # n accelerations follow the velocities
    VERSION = 0x0004  # the 8-byte id of the version the sender expects comes before the positions
    RESET = 0x0008  # the sequence starts again here; the correction ramps in from zero
    SETTLED = 0x0010  # with RESET: the arm rests at this setpoint, so give the whole correction at once
    DYNAMIC = 0x0100  # the moments include motion
    RAMPING = 0x0200  # start of the stream or a change of version is still being ramped
    REVERSING = 0x0400  # clearance or backlash changes sides: softly, or at its rate
    DAMPED = 0x0800  # near a singularity: the correction is damped
    RESIDUAL = 0x1000  # the wanted pose is out of reach of the correction; the nearest was taken
    SATURATED = 0x2000  # the correction is held at its limit, and part of the error is left
    SLOWED = 0x4000  # the correction is held back by the bound on its rate or acceleration
    UNSURE = 0x8000  # the version is less sure here than its parameters say


class Status(IntEnum):
    """Verdict on a setpoint. Only OK carries numbers."""

    OK = 0
    STALE = 1
    SEQ_GAP = 2
    SEQ_BACK = 3
    BAD_FRAME = 4
    NOT_FINITE = 5
    JOINT_LIMIT = 6
    CORRECTION_TOO_LARGE = 7
    RATE_LIMIT = 8
    NO_VERSION = 9
    VERSION_MISMATCH = 10
    OVERLOAD = 11
    NO_SESSION = 12  # the message is of no session in use; the answer has the nonce to sign with
    UNSIGNED = 13
    SESSION_EXPIRED = 14
