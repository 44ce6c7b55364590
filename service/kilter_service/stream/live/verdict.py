"""Whether the arm is driven without correction, in words that nobody can miss."""

from __future__ import annotations

from collections.abc import Sequence

from kilter_service.stream.live.shown import Reach, StreamShown


def bypass(reach: Reach, active_version: str | None, streams: Sequence[StreamShown], twice: str = "") -> str:
    """Return why setpoints are not corrected, empty when all that come are.

    ``twice`` says that the controller corrects by itself, empty where it does not.
    """
    if reach == "away":
        return (
            "The corrector does not answer, so no setpoint is corrected. A controller that drives the arm now drives it "
            "uncorrected, or has stopped. Look at the log of `kilterd corrector`."
        )
    refused = [stream for stream in streams if stream.condition == "bypass"]
    if refused:
        said = " ".join(f"Stream {stream.name}: {stream.words}" for stream in refused)
        remedy = f" {twice}" if twice else " Activate a version." if active_version is None else ""
        return f"{said} The controller drives the arm uncorrected, or has stopped.{remedy}"
    return ""
