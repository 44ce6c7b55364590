"""Sessions of signed streams, and the bridges that use them."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field

from kilter_service.contract.remarks import Remark
from kilter_service.contract.units import Strict

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
