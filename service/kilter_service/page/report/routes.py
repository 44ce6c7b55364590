"""The report of a job or a version, to read and print, and as PDF."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from fastapi import Depends, Query, Request, Response
from fastapi.responses import HTMLResponse
from markupsafe import Markup

from kilter_core.errors import CoreError
from kilter_files.look import why_unusual
from kilter_service.campaigns import looking, suspicious
from kilter_service.campaigns import service as campaigns
from kilter_service.contract.figures import IdentifyFigures
from kilter_service.contract.fits import Parameter, StageErrors
from kilter_service.contract.jobs.evaluate import EVALUATE
from kilter_service.contract.jobs.gap import GAP
from kilter_service.contract.jobs.identify import IDENTIFY
from kilter_service.contract.jobs.registry import Job
from kilter_service.contract.robot_reports import RobotReport
from kilter_service.contract.units import MAX_NAMED
from kilter_service.contract.versions import Version
from kilter_service.ground import child_process
from kilter_service.ground.child_process import Limits
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.naming import display_name
from kilter_service.ground.paging import Page
from kilter_service.jobs import service as jobs
from kilter_service.page import words
from kilter_service.page.answers import environment, render, router, source
from kilter_service.page.report import sheet as first
from kilter_service.page.report.sheet import (
    CURVES,
    HEIGHT,
    INK,
    PLACE,
    STAGES,
    before_and_after,
    closing,
    effect_contributions,
    limits,
    table,
)
from kilter_service.page.shared.curves import own_curves
from kilter_service.page.shared.errors_drawn import cumulative
from kilter_service.page.shared.naming import in_names
from kilter_service.robots import service as robots
from kilter_service.versions import service as versions
from kilter_service.versions.acceptance import Wish
from kilter_service.versions.if_match import AddressedVersion
from kilter_service.versions.routes import LARGEST_MM, REFITS, Refit
from kilter_service.versions.today import service as today
from kilter_service.web.routing import DatabaseOfApp, get_scratch

SIGMA95 = 1.96
NEGATIVE_ZERO = re.compile(r"^-(?=0(\.0+)?( |$))")


Document = dict[str, Any]


def sheet_of_version(database: Database, version_id: str, wish: Wish | None = None) -> Document:
    """Return the report of a version, whose first page decides about a tolerance where one is stated."""
    version = versions.get(database, version_id)
    sheet = _sheet(database, version, jobs.get(database, version.job_id))
    if wish is None:
        return sheet | {"first": first.first_sheet_undecided(database, version)}
    return sheet | {"first": first.first_sheet(database, version.robot, wish._replace(version=version_id))}


def sheet_of_job(database: Database, job_id: str) -> Document:
    """Return the report of a job: of the version that it made, or of what it found.

    Raises:
        ServiceError: it has not succeeded.

    """
    job = jobs.get(database, job_id)
    if job.result is None:
        raise ServiceError(
            f"Job {job_id} is {job.state}: there is a report when it has succeeded.", code="payload_invalid"
        )
    made = None if EVALUATE.is_kind_of(job) else getattr(job.result, "version_id", None)
    if made is None:
        return _sheet(database, None, job)
    version = versions.get(database, made)
    return _sheet(database, version, job) | {"first": first.first_sheet_undecided(database, version)}


def _sheet(database: Database, version: Version | None, job: Job) -> Document:
    """Return all of a report but its first page; ``names`` are of the versions that rows and evaluations name."""
    robot = robots.get(database, job.robot)
    search = job.result if GAP.is_kind_of(job) else None
    figures = job.result.figures if IDENTIFY.is_kind_of(job) and job.result is not None else None
    named = display_name(version if version is not None else job)
    odd = suspicious.of_campaigns(database, _used_campaigns(job))
    evaluated = list(_iter_evaluations(database, job, version))
    judges = {one.version_id for rows in odd for one in rows.found} | {
        one["job"].result.version_id for one in evaluated
    }
    sheet = {
        "first": None,
        "title": named if named.startswith(f"{job.robot} v") else f"{job.robot}: {named}",
        "robot": robot,
        "job": job,
        "version": version,
        "headline": getattr(job.result, "headline", None) or ("" if version is None else version.headline),
        "search": search,
        "closing": closing(search),
        "curves": own_curves(search.effect_curves) if search is not None else [],
        "evaluated": evaluated,
        "campaigns": _names(database, job),
        "suspicious": odd,
        "names": {one: in_names(database, one) for one in judges if one},
    }
    if version is None:
        return sheet | dict.fromkeys(
            ("judged", "parameters", "effects", "limits", "activations", "ranges", "today"), ()
        )
    log = versions.activations(database, job.robot, Page()).activations
    return sheet | {
        "judged": list(_iter_error_tables(version, figures)),
        "parameters": [_parameter(one) for one in version.parameters],
        "effects": effect_contributions(database, version, search) if version.effects else None,
        "limits": limits(version, search),
        "activations": [one for one in log if one.version_id == version.id],
        "ranges": _ranges(database, version, robot),
        "today": today.of_robot(database, job.robot).sentences if version.active else [],
    }


def _used_campaigns(job: Job) -> list[str]:
    return [*job.campaigns, *(job.validation if isinstance(job.validation, list) else []), *job.confirmation]


def _names(database: Database, job: Job) -> dict[str, str]:
    out = {}
    for one in _used_campaigns(job):
        try:
            out[one] = campaigns.get(database, one).name
        except ServiceError:
            out[one] = "purged"
    return out


def _ranges(database: Database, version: Version, robot: RobotReport) -> list[list[str]]:
    """From where to where each joint was measured in what was fitted, in deg or mm: the calibration holds there."""
    spans: dict[int, tuple[float, float]] = {}
    for used in version.campaigns:
        try:
            found = looking.spans(database, used.id) if used.use == "train" else {}
        except CoreError:  # it was purged, or is damaged: the hash of its file still says what it was
            continue
        for joint, (low, high) in found.items():
            before = spans.get(joint, (low, high))
            spans[joint] = min(low, before[0]), max(high, before[1])
    out = []
    for number, axis in enumerate(robot.joints):
        if number in spans:
            ends = axis.limits_deg or axis.limits_mm or (None, None)
            unit = "deg" if axis.limits_deg is not None else "mm"
            shown = (*spans[number], *ends)
            out.append([axis.name, *(words.number(value, 4) for value in shown), unit])
    return out


def _iter_error_tables(version: Version, figures: IdentifyFigures | None) -> Iterator[Document]:
    drawn = figures or IdentifyFigures()
    for errors, histogram, which, on in (
        (version.metrics.validation, drawn.held_out_errors, "held-out", "not fitted: this is the accuracy to expect"),
        (version.metrics.train, drawn.fitted_errors, "fitted", "fitted: smaller than what is to be expected elsewhere"),
    ):
        if errors is not None:
            curve = cumulative(histogram, f"{which} rows", CURVES, INK, HEIGHT)
            yield _errors(errors, f"On {which} poses", f"rows that were {on}") | {"curve": curve}


def _errors(errors: StageErrors, title: str, on: str) -> Document:
    """The errors of the models on one set of rows: the table, and its plot."""
    found = [(label, getattr(errors, name)) for name, label in STAGES if getattr(errors, name) is not None]
    head, sizes = table("Model", found)
    rows = [[*row, words.number(one.orientation_deg)] for row, (_, one) in zip(sizes, found, strict=True)]
    if errors.place_mm is not None:
        rows[0][0] = PLACE
    counts = ["" if errors.n is None else f"{words.count(errors.n)} points", words.left_out(errors.left_out), on]
    counted = "; ".join(one for one in counts if one)
    plot = before_and_after(errors, f"Errors: {title.lower()}")
    return {"title": title, "on": counted, "table": ([*head, "orientation, deg"], rows), "plot": plot}


def _parameter(one: Parameter) -> list[str]:
    unit = "" if one.unit in (None, "1") else str(one.unit)
    if one.lower is not None and one.upper is not None:
        interval = f"{_fine(one.lower, one.sigma)} to {_fine(one.upper, one.sigma)} ({one.interval_from or 'sigma'})"
    elif one.value is not None and one.sigma:
        low, high = one.value - SIGMA95 * one.sigma, one.value + SIGMA95 * one.sigma
        interval = f"{_fine(low, one.sigma)} to {_fine(high, one.sigma)}"
    else:
        interval = words.NONE
    known = (
        "by other robots"
        if one.from_prior
        else "no"
        if one.identifiable is False
        else why_unusual(one.name, one.value, one.sigma)
        if one.plausible is False
        else "yes"
    )
    return [
        one.name,
        unit,
        _fine(one.nominal, one.sigma),
        _strip_negative_zero(words.format_with_uncertainty(one.value, one.sigma)),
        _fine(one.change, one.sigma),
        interval,
        known,
    ]


def _fine(value: float | None, sigma: float | None) -> str:
    return _strip_negative_zero(words.fine(value, sigma))


def _strip_negative_zero(text: str) -> str:
    """Write a zero without a sign: -0.0 is what rounding leaves."""
    return NEGATIVE_ZERO.sub("", text)


def _iter_evaluations(database: Database, job: Job, version: Version | None) -> Iterator[Document]:
    """Evaluations of the version, newest first; of a job that is one, itself."""
    if EVALUATE.is_kind_of(job):
        found = [job]
    elif version is not None:
        whole = [jobs.get(database, one) for one in jobs.succeeded_evaluations(database, version.id)]
        found = [one for one in whole if EVALUATE.is_kind_of(one)]
    else:
        return
    for one in found:
        assert one.result is not None
        errors = (one.result.metrics or {}).items()
        judged = [_errors(part, f"Campaign {name}", f"evaluation {one.id}") for name, part in errors]
        criteria = list((one.result.iso9283 or {}).items())
        yield {"job": one, "standard": one.result.standard or "ISO 9283", "criteria": criteria, "judged": judged}


CHILD = "kilter_service.page.report.child"
LIMITS = Limits(seconds=90, memory_mb=3072, output_mb=64)
FONTS = ("FONTCONFIG_PATH", "FONTCONFIG_FILE")


def pdf(folder: Path, html: str, css: str) -> bytes:
    """Set a document.

    Raises:
        ServiceError: WeasyPrint or Pango is not installed, or it took too long.

    """
    (folder / "report.html").write_text(html, encoding="utf-8")
    (folder / "report.css").write_text(css, encoding="utf-8")
    ended = child_process.run(CHILD, folder, [], LIMITS, FONTS)
    made = folder / "report.pdf"
    if ended.code == 0 and made.exists():
        return made.read_bytes()
    lacking = folder / "lacking"
    if lacking.exists():
        raise ServiceError(
            f"PDF needs WeasyPrint and Pango, and this server lacks them ({lacking.read_text('utf-8')[:200]}): install them "
            "with `pip install weasyprint` and `apt-get install libpango-1.0-0 libpangoft2-1.0-0 libharfbuzz-subset0`, "
            "or print the report from the browser, which looks the same.",
            code="pdf_unavailable",
        )
    why = f"took longer than {LIMITS.seconds} s" if ended.late else "could not be set"
    raise ServiceError(
        f"The PDF {why}: print the report from the browser, which looks the same.", code="pdf_unavailable"
    )


def wish_from_query(
    tolerance_mm: Annotated[float | None, Query(gt=0, le=LARGEST_MM)] = None,
    campaign: Annotated[list[str] | None, Query(max_length=MAX_NAMED)] = None,
    refit: Refit | None = None,
    instrument: Annotated[str | None, Query(max_length=64)] = None,
) -> Wish | None:
    """Return what the first page is to decide; None where no tolerance is stated."""
    if tolerance_mm is None:
        return None
    return Wish(tolerance_mm, None, campaign or (), None if refit is None else REFITS[refit], instrument)


WishOfReport = Annotated[Wish | None, Depends(wish_from_query)]


@router.get("/versions/{version}/report")
def show_of_version(
    version: AddressedVersion, request: Request, database: DatabaseOfApp, wish: WishOfReport
) -> HTMLResponse:
    """Show the report of a version; where a tolerance is stated, with the decision about it on the first page."""
    sheet = sheet_of_version(database, version, wish)
    return render(
        request, "report/page.html", sheet=sheet, place=f"/versions/{version}", query=request.url.query if wish else ""
    )


@router.get("/jobs/{job}/report")
def show_of_job(job: str, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show the report of a job."""
    return render(request, "report/page.html", sheet=sheet_of_job(database, job), place=f"/jobs/{job}")


@router.get("/jobs/{job}/report.html")
def job_page(job: str, database: DatabaseOfApp) -> HTMLResponse:
    """Return the report of a job as one page that needs no other file, to keep or to send; it decides no tolerance."""
    sheet = sheet_of_job(database, job) | {"first": None}
    return HTMLResponse(_render_printed(sheet, source("report.css")))


@router.get("/versions/{version}/report.pdf")
def version_pdf(version: AddressedVersion, request: Request, database: DatabaseOfApp, wish: WishOfReport) -> Response:
    """Return the report of a version as PDF."""
    return _pdf(request, database, sheet_of_version(database, version, wish))


@router.get("/jobs/{job}/report.pdf")
def job_pdf(job: str, request: Request, database: DatabaseOfApp) -> Response:
    """Return the report of a job as PDF."""
    return _pdf(request, database, sheet_of_job(database, job))


def _render_printed(sheet: Document, css: str = "") -> str:
    shown: dict[str, Any] = {"sheet": sheet, "css": Markup(css)}  # noqa: S704 (our own style sheet)
    return environment().get_template("report/printed.html").render(**shown)


def _pdf(request: Request, database: Database, sheet: Document) -> Response:
    with get_scratch(request).folder_for("report") as folder:
        made = pdf(folder, _render_printed(sheet), source("report.css"))
    name = (sheet["version"] or sheet["job"]).id
    return Response(
        made, media_type="application/pdf", headers={"Content-Disposition": f'inline; filename="{name}.pdf"'}
    )
