"""Sessions of signed streams, and the bridges that use them.

What a message of the stream says beside its numbers, as docs/reference/stream.md tables it: kinds, flags and verdicts.
"""

from __future__ import annotations

from datetime import datetime
from enum import IntEnum
from typing import Annotated, Literal

from pydantic import Field

from kilter_service.contract.units import Strict
from kilter_service.contract.wording import Remark

BridgeKind = Literal["rsi", "egm", "fci"]
BridgeState = Literal[
    "starting",
    "waiting",
    "refusing",
    "ramping in",
    "correcting",
    "holding back",
    "fading out",
    "off",
    "ended",
    "killed",
]
Count = Annotated[int, Field(ge=0, le=2**53)]


class BridgeNews(Strict):
    """What a bridge says of itself, every 2 s and when its state changes."""

    kind: BridgeKind = Field(description="Controller: `rsi` KUKA, `egm` ABB, `fci` Franka.")
    state: BridgeState = Field(description="What it does; `killed`: it vanished without saying that it ends.")
    why: str = Field("", max_length=500, description="Why it does not correct; empty where it does.")
    version_id: str = Field(max_length=64, description="The version it corrects with.")
    controller: str | None = Field(None, max_length=200, description="Address of the controller; null: none asks.")
    cycle_ms: float = Field(gt=0.0, le=1000.0, description="Cycle of the controller, ms.")
    cycles: Count = Field(description="Cycles answered since it began.")
    late: Count = Field(description="Answers later than a cycle; to a Franka robot these are not sent.")
    lost: Count = Field(description="Cycles for which no request came.")
    refused: Count = Field(description="Cycles whose joints could not be corrected.")
    offset_deg: float = Field(ge=0.0, le=180.0, description="Largest offset of a joint now, degrees.")
    largest_offset_deg: float = Field(
        ge=0.0, le=180.0, description="Largest offset of a joint since it began, degrees."
    )


class Bridge(BridgeNews):
    """A bridge as the server knows it."""

    id: str = Field(description="Id of the run of this bridge.")
    robot: str = Field(description="Name of the robot.")
    since: datetime = Field(description="When it was first heard.")
    heard_at: datetime = Field(description="When it was last heard.")
    silent_s: float = Field(description="For how long it has not been heard, s.")
    gone: bool = Field(
        description="Whether it is gone: it has ended, was killed, or was not heard for 6 s; then nothing corrects the arm."
    )
    other_version: bool = Field(description="Whether it corrects with a version that is not the active one.")
    corrected_twice: bool = Field(
        False, description="Whether the controller corrects by itself, and this bridge offsets the joints on top of it."
    )
    sentence: str = Field(description="The same in words.")


class BridgeList(Strict):
    """Bridges of a robot: those that run first, then the newest. Those that are gone for a day are forgotten."""

    bridges: list[Bridge] = Field(description="The bridges.")


Hex32 = Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]
Hex64 = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class NewStreamSession(Strict):
    """For which stream, and for how long."""

    stream: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")] = Field(
        "main", description="Name of the stream; two controllers must not share one."
    )
    lifetime_h: Annotated[float, Field(gt=0.0, le=168.0)] = Field(
        24.0, description="How long the session is valid, hours; a controller asks for the next one before it ends."
    )
    take_over: bool = Field(
        False,
        description="End the sessions that others hold of this stream, at once; without it a stream that somebody else "
        "holds is refused. The audit says who took over from whom.",
    )


class StreamSession(Strict):
    """Id and keys of a session. Whoever has them can send setpoints on this stream."""

    site: str = Field(description="Site in the keys of the stream.")
    robot: str = Field(description="Name of the robot.")
    stream: str = Field(description="Name of the stream.")
    session: Hex32 = Field(description="Id of the session, which every frame carries, hexadecimal.")
    key: Hex64 = Field(description="Key of the session, hexadecimal; a secret.")
    announcement_key: Hex64 = Field(
        description="Key with which the corrector signs what it announces about the robot, hexadecimal; a secret."
    )
    expires_at: datetime = Field(description="When the session ends.")
    max_age_ms: float = Field(description="A setpoint that arrives later than this after it was sent is refused, ms.")
    max_joints: int = Field(description="Largest number of joints of a setpoint.")
    max_points: int = Field(description="Largest number of points of a chunk.")
    warnings: list[Remark] = Field(
        [],
        description="What to know before the arm is driven, as that nobody said whether the "
        "controller corrects by itself.",
    )


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
