"""The verb that asks whether an arm has moved: it sends some poses and checks them against the version that corrects."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from typing import TYPE_CHECKING, Any, Unpack, cast

from kilter_client.errors import UsageError
from kilter_client.requests.steps import Steps
from kilter_client.verbs import campaigns, jobs
from kilter_client.verbs.inputs import Data, ResourceReference, reference
from kilter_client.verbs.progress import Watching

if TYPE_CHECKING:
    from datetime import date, datetime

    from kilter_client.typed.drifts import DriftResult, RezeroResult
    from kilter_client.typed.options import DriftOptions, RezeroOptions


def drift(
    robot: ResourceReference,
    data: Data | None = None,
    *,
    campaign: ResourceReference | None = None,
    device: str | None = None,
    column_map: str | PathLike[str] | None = None,
    payload_kg: float | None = None,
    temperature_c: float | None = None,
    measured_at: datetime | date | str | None = None,
    instrument: str | None = None,
    name: str = "",
    progress: Watching = True,
    timeout_s: float | None = None,
    **options: Unpack[DriftOptions],
) -> Steps[DriftResult]:
    """Say whether an arm has moved since its version was made, and which one change explains it.

    The rows are stored as a campaign with the role ``validation``: no fit takes them unless it names them. Where
    they are refused, as of another arm or too few, the server retires them.

    Args:
        robot: name of the robot.
        data: rows of three poses or more, as ``upload`` takes them.
        campaign: a campaign that is stored already, instead of data.
        device: the measuring device; files of some devices are converted.
        column_map: column map of a lab's own file.
        payload_kg: mass at the tool point, kg.
        temperature_c: temperature of the arm, degrees Celsius.
        measured_at: when the last row was measured.
        instrument: name of the instrument that measured, as `instruments` lists them.
        name: name of the campaign and of the job.
        progress: True for a bar, False for none, or a function of the fraction done and the stage.
        timeout_s: seconds to wait at most; the job continues.
        options: the options of the job by name, as ``new_setup=["base"]``, ``noise_mm=0.05``.

    Raises:
        UsageError: neither data nor a campaign, or both.
        ObservationError: the rows are not what their columns say.
        JobFailedError: the check was refused, as for rows of another arm; JobTimeoutError: it continues.

    """
    if (data is None) == (campaign is None):
        raise UsageError("Give the rows to check with, or campaign= of rows that are stored.")
    if campaign is None:
        assert data is not None
        sent = yield from campaigns.upload(
            robot,
            data,
            name=name or None,
            role="validation",
            device=device,
            column_map=column_map,
            payload_kg=payload_kg,
            temperature_c=temperature_c,
            measured_at=measured_at,
            instrument=instrument,
            progress=progress,
        )
        asked = jobs.request_body("drift", robot, sent.campaign_id, options, None, name)
        return cast("DriftResult", (yield from jobs.run(asked, progress, timeout_s)))
    _refuse_known(
        {
            "device": device,
            "column_map": column_map,
            "payload_kg": payload_kg,
            "temperature_c": temperature_c,
            "measured_at": measured_at,
            "instrument": instrument,
        }
    )
    asked = jobs.request_body("drift", robot, reference("campaign", campaign), options, None, name)
    return cast("DriftResult", (yield from jobs.run(asked, progress, timeout_s)))


def rezero(
    robot: ResourceReference,
    campaign: ResourceReference = "latest",
    *,
    name: str = "",
    progress: Watching = True,
    timeout_s: float | None = None,
    **options: Unpack[RezeroOptions],
) -> Steps[RezeroResult]:
    """Make a version of the one or few parameters that moved, by the rows of a check; activate it as any other.

    Without ``causes`` it is what a check of these rows names, if that is one cause.

    Raises:
        JobFailedError: the rows do not say which parameter moved; JobTimeoutError: it continues.

    """
    asked = jobs.request_body("rezero", robot, reference("campaign", campaign), options, None, name)
    return cast("RezeroResult", (yield from jobs.run(asked, progress, timeout_s)))


def _refuse_known(given: Mapping[str, Any]) -> None:
    named = [name for name, value in given.items() if value is not None]
    if named:
        raise UsageError(f"{named[0]}= belongs to rows that are sent: the campaign has its own.")
