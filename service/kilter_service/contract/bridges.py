"""Bridges: processes between a controller and its arm, as they announce themselves to the server."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field

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
