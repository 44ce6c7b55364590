"""A load that nobody stated, in words: the same wherever a load matters, in jobs, their checks and corrections."""

from __future__ import annotations

from collections.abc import Sequence

REMEDY = (
    "Say the load with payload_kg (0 for an empty tool), as a column or for the whole {whole}, or give the robot a default "
    "load."
)


def counted_as_nothing(subject: str, following: Sequence[str]) -> str:
    """Say that a payload which nobody stated counts as 0 kg, and for which effects that matters."""
    named = ", ".join(following[:3]) + (f" and {len(following) - 3} more effects" if len(following) > 3 else "")
    return (
        f"{subject} no payload and the robot has no default load, so it counted as 0 kg: {named} "
        f"{'follows' if len(following) == 1 else 'follow'} the load."
    )
