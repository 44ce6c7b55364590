"""The reference of the Python library says everything: every verb, its units, and exceptions that exist."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import pytest

import kilter

DOCS = Path(__file__).resolve().parents[2] / "docs"
VERBS = sorted(
    name
    for name, value in vars(kilter.AsyncKilter).items()
    if callable(value) and not name.startswith("_") and name not in ("run", "close")
)


@pytest.mark.parametrize("name", VERBS)
def test_every_verb_is_described(name: str) -> None:
    verb = getattr(kilter.AsyncKilter, name)
    text = inspect.getdoc(verb) or ""
    assert f"\n### k.{name}\n" in (DOCS / "reference/library.md").read_text(encoding="utf-8")
    assert len(text) > 20
    raised = re.findall(r"\b(\w+Error)\b", text)
    assert all(issubclass(getattr(kilter, kind), kilter.KilterError) for kind in raised)
    told = text.partition("Args:\n")[2].partition("Raises:\n")[0]
    if told:
        named = set(re.findall(r"^    (\w+): ", told, re.MULTILINE))
        assert named == set(inspect.signature(verb).parameters) - {"self"}
        for unit, words in (("_mm", "mm"), ("_kg", "kg"), ("_deg", "deg"), ("_nm", "N m"), ("_n", " N.")):
            for argument in (one for one in named if one.endswith(unit)):
                (line,) = re.findall(rf"^    {argument}: (.*)$", told, re.MULTILINE)
                assert words in line, argument


def test_the_lab_script_is_as_long_as_it_says() -> None:
    page = (DOCS / "how-to/lab-script.md").read_text(encoding="utf-8")
    script = page.partition("## Fifteen lines")[2].partition("```python tested\n")[2].partition("```")[0]
    assert len([line for line in script.splitlines() if line]) == 15


def test_every_type_is_in_the_reference() -> None:
    from kilter_client.typed.names import MODULE_OF

    page = (DOCS / "reference/library-types.md").read_text(encoding="utf-8")
    assert not [name for name in MODULE_OF if f"\n### {name}\n" not in page]
