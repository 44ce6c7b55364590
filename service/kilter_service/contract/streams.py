"""Sessions of signed streams."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated

from pydantic import Field

from kilter_service.contract.remarks import Remark
from kilter_service.contract.units import Strict

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
