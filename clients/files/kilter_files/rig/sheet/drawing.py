"""The sheet as a page: SVG and PDF, both in true mm."""

from __future__ import annotations

from pathlib import Path

from kilter_files.rig.printed import Printed, save_page
from kilter_files.rig.sheet.layout import PAGES_MM, Sheet
from kilter_files.rig.sheet.shapes import shapes


def save_sheet(sheet: Sheet, path: Path) -> int:
    """Write the sheet as the file's ending says, ``.pdf`` or ``.svg``; returns the bytes written.

    Raises:
        UsageError: another ending.
        FileError: the file cannot be written.
        MissingPackageError: OpenCV, or for PDF reportlab, is not installed.

    """
    return save_page(sheet_page(sheet), path)


def sheet_page(sheet: Sheet) -> Printed:
    """Return the page of the sheet; the same sheet gives the same bytes."""
    return Printed(f"Kilter sheet, radius {sheet.radius_mm:g} mm", PAGES_MM[sheet.page], tuple(shapes(sheet)))
