"""What link-side encoders say of joints."""

from __future__ import annotations

from pydantic import Field

from kilter_service.contract.units import Deg, Stored


class Motion(Stored):
    """A motion of a joint, before and after what was found of it is taken off."""

    campaign: str | None = Field(None, description="Id of the campaign.")
    use: str | None = Field(None, description="`fitted` or `predicted`.")
    raw_deg: Deg | None = Field(None, description="Standard deviation of link minus motor angle, degrees.")
    left_deg: Deg | None = Field(None, description="What is left of it, degrees.")


class JointMotions(Stored):
    """A joint with an encoder on its link side."""

    joint: str = Field(description="Name of the joint.")
    dead: str | None = Field(None, description="Why its channel says nothing; null: it does.")
    motions: list[Motion] | None = Field(None, description="Its motions, fitted and predicted.")
