"""The notebook of the lab script is the page as it is now, and its cells run one after the other on a server."""

from __future__ import annotations

import json
import re
import shutil
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from tools.make_notebook import NOTEBOOK, PAGE, REPOSITORY, notebook


@pytest.fixture
def cells() -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    return found


def test_the_notebook_is_made_from_the_page() -> None:
    made = notebook(PAGE.read_text(encoding="utf-8"))
    assert NOTEBOOK.read_text(encoding="utf-8") == made, "python -m tools.make_notebook writes it anew"


def test_its_links_lead_somewhere(cells: list[dict[str, Any]]) -> None:
    text = "".join(line for cell in cells if cell["cell_type"] == "markdown" for line in cell["source"])
    links = re.findall(r"\]\(([^)#]+)", text)
    assert len(links) > 2
    assert all((NOTEBOOK.parent / link).exists() for link in links), links


def test_its_cells_run_in_their_order(
    server: Path, cells: list[dict[str, Any]], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(REPOSITORY / "docs" / "tutorial", tmp_path / "docs" / "tutorial")
    (tmp_path / "examples").mkdir()
    monkeypatch.chdir(tmp_path / "examples")
    names: dict[str, Any] = {}
    with ExitStack() as opened:
        for cell in cells:
            if cell["cell_type"] == "code":
                exec(compile("".join(cell["source"]), cell["id"], "exec"), names)  # noqa: S102 (the repository's own)
                opened.callback(names["k"].close if "k" in names else int)
    assert (tmp_path / "worst.svg").read_text().startswith(("<svg", "<?xml"))
    assert len((tmp_path / "corrected.csv").read_text().splitlines()) > 100
    errors = names["v"].metrics.to_pandas()
    (mean_mm,) = errors[(errors["rows"] == "held out") & (errors["model"] == "identified")]["mean_mm"]
    assert mean_mm < 0.03
    assert "<table" in names["v"]._repr_html_()
