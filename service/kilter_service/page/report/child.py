"""Sets a report as PDF: ``python -m kilter_service.page.report.child``, in a folder with report.html and report.css."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NoReturn

from kilter_service.ground.child_process import confine


def main() -> None:
    """Write report.pdf, or say what is lacking."""
    confine()
    try:
        from weasyprint import CSS, HTML
        from weasyprint.text.fonts import FontConfiguration
    except (ImportError, OSError) as error:
        Path("lacking").write_text(str(error).splitlines()[0], encoding="utf-8")
        raise SystemExit(1) from None
    fonts = FontConfiguration()
    text = Path("report.html").read_text(encoding="utf-8")
    sheet = CSS(string=Path("report.css").read_text(encoding="utf-8"), font_config=fonts, url_fetcher=_nothing)
    document = HTML(string=text, url_fetcher=_nothing)
    # Nothing of it depends on the time or on chance, so that the same version gives the same bytes.
    document.write_pdf("report.pdf", stylesheets=[sheet], font_config=fonts, pdf_identifier=b"kilter-report")


def _nothing(url: str, *_: Any, **__: Any) -> NoReturn:
    """Fetch nothing: a report holds all that it shows."""
    raise ValueError(f"A report fetches nothing, and {url[:100]} was asked for.")


if __name__ == "__main__":
    main()
