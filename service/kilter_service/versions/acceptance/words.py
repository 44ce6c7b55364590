"""A decision about a tolerance in words."""

from __future__ import annotations

from collections.abc import Iterator

from kilter_service.contract.acceptance import Decision, JudgedCampaign
from kilter_service.contract.remarks import Remark

RULE = (
    "ISO 14253-1: accepted where every measured error and its guard band are within the tolerance, rejected where one is "
    "beyond it by its guard band, else neither is proved. The guard band is the expanded uncertainty of the measured error, "
    "k = 2."
)
WHY = {
    "repeatability": "no pose was visited twice among the rows that were fitted, or, where a camera or a contact measured "
    "those, among these rows, so the scatter of readings is not part of the guard band",
    "temperature": "the temperature was not measured, so growth is not part of the guard band",
}


def sentence(
    decision: Decision, tolerance_mm: float, rows: int, worst: JudgedCampaign, provable_mm: float, lacking: list[Remark]
) -> str:
    """Say what was decided and by which row."""
    row = (
        f"row {worst.row} of {worst.name} has {worst.error_mm:.3g} mm with a guard band of {worst.guard_band_mm:.3g} mm"
    )
    if decision == "accepted":
        return f"Accepted: all {rows} held-out rows prove {tolerance_mm:g} mm; the worst, {row}."
    if decision == "rejected":
        return f"Rejected: {row}, beyond {tolerance_mm:g} mm by more than that."
    if lacking:
        return f"Neither is proved: {lacking[0].message}"
    return f"Neither is proved: {row}; {tolerance_mm:g} mm is within that band. These rows prove {provable_mm:.3g} mm."


def missing_evidence_remarks(campaign: JudgedCampaign, certificate: list[Remark]) -> Iterator[Remark]:
    """Say why rows prove nothing, whatever their numbers."""
    if campaign.instrument is None:
        message = (
            f"campaign {campaign.name} names no instrument, so the guard band lacks its error. Add it "
            "(`kilter instrument add`) and name it: `kilter accept --instrument NAME`."
        )
        yield Remark(code="instrument_not_named", message=message, campaigns=[campaign.id])
    yield from (one.model_copy(update={"campaigns": [campaign.id]}) for one in certificate)


def guard_band_warnings(campaign: JudgedCampaign) -> Iterator[Remark]:
    """Say what the guard band lacks."""
    for source in campaign.budget.not_assessed:
        if source in WHY:
            message = f"Campaign {campaign.name}: {WHY[source]}."
            yield Remark(code=f"{source}_not_assessed", message=message, campaigns=[campaign.id])


def too_few(campaign: str) -> str:
    """Say that a campaign has too few poses to be judged, and what helps."""
    return (
        f"Campaign {campaign} has too few distinct poses to be judged: before and after are compared with base and tool "
        "fitted to it, which takes three, better ten all over the room. Measure more, or name other campaigns (--campaign)."
    )


def another_arm(campaign: str) -> str:
    """Say that rows may be of another arm, and what helps."""
    return (
        f"campaign {campaign} misses the version by more than 2 % of the arm's reach, and no one cause explains it: its rows "
        f"are of another arm or set-up, or the arm is far off. Where they are not of this arm, take it out of use (`kilter "
        f"campaigns retire {campaign}`); else name it, and it is judged (`kilter accept --campaign {campaign}`)."
    )
