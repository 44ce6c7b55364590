"""The report of a job or a version, to read and print, and as PDF."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.responses import HTMLResponse
from markupsafe import Markup

from kilter_service.contract.units import MAX_NAMED
from kilter_service.ground.db import Database
from kilter_service.ground.errors import ServiceError
from kilter_service.ground.processes import sandbox
from kilter_service.ground.processes.sandbox import Limits
from kilter_service.page.report import service
from kilter_service.page.report.service import Sheet
from kilter_service.page.route import PageRoute
from kilter_service.page.shell import environment, render, source
from kilter_service.versions.acceptance.routes import LARGEST_MM, REFITS, Refit
from kilter_service.versions.acceptance.service import Wish
from kilter_service.versions.addressed import AddressedVersion
from kilter_service.web.state import DatabaseOfApp, get_scratch

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
    ended = sandbox.run(CHILD, folder, [], LIMITS, FONTS)
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


router = APIRouter(include_in_schema=False, route_class=PageRoute)


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
def of_version(
    version: AddressedVersion, request: Request, database: DatabaseOfApp, wish: WishOfReport
) -> HTMLResponse:
    """Show the report of a version; where a tolerance is stated, with the decision about it on the first page."""
    sheet = service.of_version(database, version, wish)
    return render(
        request, "report/page.html", sheet=sheet, place=f"/versions/{version}", query=request.url.query if wish else ""
    )


@router.get("/jobs/{job}/report")
def of_job(job: str, request: Request, database: DatabaseOfApp) -> HTMLResponse:
    """Show the report of a job."""
    return render(request, "report/page.html", sheet=service.of_job(database, job), place=f"/jobs/{job}")


@router.get("/jobs/{job}/report.html")
def job_page(job: str, database: DatabaseOfApp) -> HTMLResponse:
    """Return the report of a job as one page that needs no other file, to keep or to send; it decides no tolerance."""
    sheet = replace(service.of_job(database, job), first=None)
    return HTMLResponse(_render_printed(sheet, source("report.css")))


@router.get("/versions/{version}/report.pdf")
def version_pdf(version: AddressedVersion, request: Request, database: DatabaseOfApp, wish: WishOfReport) -> Response:
    """Return the report of a version as PDF."""
    return _pdf(request, database, service.of_version(database, version, wish))


@router.get("/jobs/{job}/report.pdf")
def job_pdf(job: str, request: Request, database: DatabaseOfApp) -> Response:
    """Return the report of a job as PDF."""
    return _pdf(request, database, service.of_job(database, job))


def _render_printed(sheet: Sheet, css: str = "") -> str:
    shown: dict[str, Any] = {"sheet": sheet, "css": Markup(css)}  # noqa: S704 (our own style sheet)
    return environment().get_template("report/printed.html").render(**shown)


def _pdf(request: Request, database: Database, sheet: Sheet) -> Response:
    with get_scratch(request).folder_for("report") as folder:
        made = pdf(folder, _render_printed(sheet), source("report.css"))
    name = sheet.version.id if sheet.version is not None else sheet.job.id
    return Response(
        made, media_type="application/pdf", headers={"Content-Disposition": f'inline; filename="{name}.pdf"'}
    )
