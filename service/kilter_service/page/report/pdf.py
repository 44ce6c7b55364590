"""A report as PDF: set by WeasyPrint in a process of its own, which fetches nothing."""

from __future__ import annotations

from pathlib import Path

from kilter_service.ground.errors import ServiceError
from kilter_service.ground.processes import sandbox
from kilter_service.ground.processes.sandbox import Limits

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
