"""The sheet as a page: SVG and PDF, both in true mm."""

from __future__ import annotations

from pathlib import Path

from kilter_files.rig.printed import Printed, page_pdf, page_svg, save_page
from kilter_files.rig.sheet.layout import PAGES_MM, Sheet
from kilter_files.rig.sheet.shapes import shapes


def save_sheet(sheet: Sheet, path: Path) -> int:
    """Write the sheet as the file's ending says, ``.pdf`` or ``.svg``; returns the bytes written.

    Raises:
        UsageError: another ending.
        FileError: the file cannot be written.
        MissingPackageError: OpenCV, or for PDF reportlab, is not installed.

    """
    return save_page(_page(sheet), path)


def to_svg(sheet: Sheet) -> str:
    """Return the sheet as SVG text; its user units are mm."""
    return page_svg(_page(sheet))


def to_pdf(sheet: Sheet) -> bytes:
    """Return the sheet as a PDF of one page; the same sheet gives the same bytes.

    Raises:
        MissingPackageError: reportlab is not installed.

    """
    return page_pdf(_page(sheet))


def _page(sheet: Sheet) -> Printed:
    return Printed(f"Kilter sheet, radius {sheet.radius_mm:g} mm", PAGES_MM[sheet.page], tuple(shapes(sheet)))
