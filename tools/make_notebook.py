"""Write the notebook of the lab script: ``python -m tools.make_notebook`` makes ``examples/lab.ipynb`` from its page.

The page says it once: its prose becomes cells of text, each paragraph of its code becomes a cell.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parent.parent
PAGE = REPOSITORY / "docs" / "how-to" / "lab-script.md"
NOTEBOOK = REPOSITORY / "examples" / "lab.ipynb"
END = "## In a notebook"  # what stands below is for scripts
BEGIN = 'import os\n\nos.chdir("..")  # the folder of the checkout, where docs/tutorial is'
CODE = re.compile(r"^```python tested\n(.*?)^```\n", re.DOTALL | re.MULTILINE)


def main() -> None:
    """Write the notebook."""
    NOTEBOOK.write_text(notebook(PAGE.read_text(encoding="utf-8")), encoding="utf-8")


def notebook(page: str) -> str:
    """Return the notebook of a page, as Jupyter stores one."""
    cells = [_cell(number, kind, text) for number, (kind, text) in enumerate(_parts(page[: page.index(END)]))]
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    document = {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(document, indent=1, ensure_ascii=False) + "\n"


def _parts(page: str) -> Iterator[tuple[str, str]]:
    pieces = CODE.split(page)
    for k, piece in enumerate(pieces):
        if k == 1:
            yield "code", BEGIN
        if k % 2:
            yield from (("code", part) for part in piece.strip().split("\n\n"))
        elif piece.strip():
            yield "markdown", _link_from_examples(piece.strip())


def _link_from_examples(text: str) -> str:
    """Return text of a page of ``docs/how-to`` with its links as they are from ``examples``."""
    up = re.sub(r"\]\(\.\./(?!\.\.)", "](../docs/", text)
    return re.sub(r"\]\((?=[\w-]+\.md)", "](../docs/how-to/", up)


def _cell(number: int, kind: str, text: str) -> dict[str, Any]:
    ran: dict[str, Any] = {"execution_count": None, "outputs": []} if kind == "code" else {}
    source = text.splitlines(keepends=True)
    return {"cell_type": kind, "id": f"part-{number}", "metadata": {}, **ran, "source": source}


if __name__ == "__main__":
    main()
