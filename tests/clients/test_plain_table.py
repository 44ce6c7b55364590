"""Tables of commands: columns line up, and a narrow screen folds cells instead of cutting them."""

from __future__ import annotations

import pytest

from kilter_client.cli.terminal.output import table

HEAD = ("effect", "what")
ROWS = [("backlash", "reversal error with the direction of the joint's last motion"), ("x", "")]


def test_columns_line_up_without_spaces_at_the_end() -> None:
    assert table(("a", "b"), [("x", "1.5"), ("yy", "22")], 80, "held out", numbers=True).split("\n") == [
        "", "held out", " a      b", " ────────", " x    1.5", " yy    22", "",
    ]  # fmt: skip


@pytest.mark.parametrize("screen", [40, 60, 200])
def test_nothing_is_cut(screen: int) -> None:
    lines = table(HEAD, ROWS, screen).split("\n")
    assert max(map(len, lines)) <= screen
    words = " ".join(line[1:] for line in lines).split()
    assert [word for word in ROWS[0][1].split() if word not in words] == []
    assert (len(lines) == 6) == (screen == 200)


def test_a_screen_narrower_than_the_columns_and_no_rows() -> None:
    assert "backlash" in table(HEAD, ROWS, 5)
    assert table(HEAD, [], 80).split("\n") == ["", " effect   what", " ─────────────", ""]
