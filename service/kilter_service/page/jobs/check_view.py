"""The result of a check: what moved, its poses before and after that cause, and the causes that may be it instead."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from kilter_service.contract.jobs.drift import DriftCause, DriftJob, DriftResult
from kilter_service.contract.today import NextStep
from kilter_service.ground.db import Database
from kilter_service.page.figures.plot import BLUE, RED, Plot
from kilter_service.page.figures.scale import category_axis, lengths
from kilter_service.page.figures.space import Arrows, Space
from kilter_service.page.words import in_columns, number, percent
from kilter_service.versions.drift import service as drift
from kilter_service.versions.today import service as today

LOOKS = {
    "ok": ("As its version says", "good"),
    "moved": ("Has moved", "bad"),
    "cannot_tell": ("Moved, cause unknown", "bad"),
}
MOST_BARS, MOST_RIVALS = 24, 4
LIKELY = 1e-3


@dataclass(frozen=True)
class Rival:
    """A cause that was looked at: its chance among all, how much it would be, and the mean error that it leaves, mm."""

    words: str
    chance: str
    change: str
    left_mm: float | None
    refuted: bool


def result_context(database: Database, job: DriftJob) -> dict[str, Any]:
    """Return what ``jobs/drift.html`` shows."""
    result = job.result or DriftResult()
    rows = result.rows or []
    named = result.causes[0] if result.causes else None
    last = drift.of_robot(database, job.robot).last
    steps: list[NextStep] = []
    if last is not None and last.job_id == job.id:  # of an older check something else comes next
        standing = today.of_robot(database, job.robot).standing
        steps = [] if standing is None else standing.steps
    errors = [one.error_mm for one in rows]
    after = [one.after_mm for one in rows]
    kinds = [Arrows("as measured", "bad", errors)]
    if named is not None and any(one is not None for one in after):
        kinds.append(Arrows(f"with {named.words}", "chosen", after))
    table = (["Row", "x, mm", "y, mm", "z, mm"], [[str(one.row), *(f"{v:.1f}" for v in one.at_mm)] for one in rows])
    names = [f"row {one.row}" for one in rows]
    return {
        "result": result,
        "state": LOOKS.get(result.verdict or "", ("", "faint")),
        "named": named,
        "steps_next": steps,
        "space": Space("The poses of the check", [one.at_mm for one in rows], names, kinds, table=table)
        if rows
        else None,
        "bars": _bars(result, named) if rows else None,
        "rivals": rivals(result) if result.verdict != "ok" else [],
        "explained": bool(result.causes),
        "mean": next((one.identified for one in (result.metrics or {}).values()), None),
        "version": None,
        "checked": result.version_id,
    }


def _bars(result: DriftResult, named: DriftCause | None) -> Plot:
    rows = sorted(result.rows or [], key=lambda one: -math.hypot(*one.error_mm))[:MOST_BARS]
    before = [math.hypot(*one.error_mm) for one in rows]
    after = [math.hypot(*one.after_mm) for one in rows if one.after_mm is not None]
    both = len(after) == len(rows)
    unit, written = in_columns([[a, b] for a, b in zip(before, after if both else before, strict=True)])
    names = [f"row {one.row}" for one in rows]
    head = ["Row", f"Error, {unit}", *([f"If it is {named.words}, {unit}"] if both and named else [])]
    table = (head, [[name, *one[: len(head) - 1]] for name, one in zip(names, written, strict=True)])
    said = "The error of each pose, and what is left of it if the named cause is it."
    drawn = Plot(
        "Error of each pose", category_axis("", names), lengths("error", before, zero=True), 620.0, 200.0, said, table
    )
    shift = 0.2 if both else 0.0
    drawn.bars([k + 0.5 - shift for k in range(len(rows))], before, 0.36, "as measured", colour=RED)
    if both and named:
        drawn.bars([k + 0.5 + shift for k in range(len(rows))], after, 0.36, f"with {named.words}", colour=BLUE)
    return drawn


def rivals(result: DriftResult) -> list[Rival]:
    """Return the causes with their chances: each by how much worse than the best it explains the rows (BIC)."""
    known = [(one, one.bic) for one in result.looked_at or [] if one.bic is not None]
    best = min((bic for _, bic in known), default=0.0)
    weights = [math.exp(-0.5 * min(bic - best, 700.0)) for _, bic in known]
    whole = sum(weights) or 1.0
    out = []
    for (one, _), weight in zip(known, weights, strict=True):
        share = weight / whole
        left = None if not one.left_mm else sum(one.left_mm) / len(one.left_mm)
        said = percent(share) if share > LIKELY else f"< {percent(LIKELY)}" if share > 0 else "0 %"
        told = [n for n in one.numbers or [] if len(one.numbers or []) == 1 or n.unit == "mm"]  # of a frame its shift
        size = math.hypot(*(n.change for n in told)) if len(told) > 1 else sum(n.change for n in told)
        change = f"{number(size, 2)} {told[0].unit}" if told else ""
        out.append(Rival(one.words or one.name, said.replace("< 0 %", "< 0.1 %"), change, left, bool(one.refuted)))
    return sorted(out, key=lambda one: (one.left_mm is None, one.left_mm))[:MOST_RIVALS]
