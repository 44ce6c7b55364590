"""The words of documentation, help, errors, docstrings, templates, scripts and names: standard terms, plain English.

``RULES`` is the one table: what is refused, the term that stands for it, and the areas in which it is refused so far.
``python -m tests.contract.test_words core`` lists what would be refused in an area that has not joined yet.
"""

from __future__ import annotations

import ast
import html
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from tests.contract.sources import REPOSITORY, nodes

MOST_CHARACTERS = 120
FENCE = r"^ *```.*?^ *```"
# Made by `make contract` from the contract and from docstrings: the words of their sources are looked at instead.
GENERATED = (
    "docs/reference/library.md",
    "docs/reference/library-types.md",
    "clients/python/src/kilter_client/typed/",
    "clients/python/src/kilter_client/cli/texts/lists.json",
    "service/kilter_service/contract/effects.json",
    "service/kilter_service/page/static/",  # bundled from what is in page/sources
    *(f"clients/matlab/+kilter/{kind}.m" for kind in ("identify", "gap", "evaluate", "plan")),
)
# Where words are looked for.
AREAS = {
    "docs": ("README.md", "CONTRIBUTING.md", "SECURITY.md", "docs", "clients", "core/README.md"),
    "clients": ("clients", "examples"),
    "core": ("core",),
    "service": ("service",),
}
MENDED = ("core", "docs", "clients", "service")
# Functions, classes and modules that still have a word which a term replaces; only ever fewer.
NAMES_STILL = {
    "turn": 30, "null direction": 5, "slide": 3, "foot": 3, "spare": 3,
}  # fmt: skip


@dataclass(frozen=True)
class Rule:
    """A word that is refused, unless it is used in one of its other senses.

    ``term`` is what the glossary has instead, empty where there is no term. ``wrong`` must be found and ``fine`` must
    not; the comment beside ``fine`` gives the reason for ``other_senses``.
    """

    refused: str
    term: str
    wrong: str
    fine: str = ""
    other_senses: str = ""
    areas: tuple[str, ...] = MENDED

    def found(self, text: str) -> list[str]:
        allowed = [match.span() for match in re.finditer(self.other_senses, text, re.I)] if self.other_senses else []
        return [
            match.group()
            for match in re.finditer(self.refused, text, re.I)
            if not any(start <= match.start() and match.end() <= end for start, end in allowed)
        ]


RULES = (
    # Standard terms of the field.
    Rule(r"\bslid(?:es?|ing)\b", "prismatic joint", "A sliding joint is given in mm."),
    Rule(
        r"\bturn(?:s|ed|ing)?\b", "rotation", "The tool is turned by the last joint.",
        # A turn is an angle of 360 degrees; the rest are idioms that mean no motion.
        "A full turn, twice per turn, a turn of the motor; each in turn, degrees turned into radians, it turned out to be.",
        r"\bin turns?\b|\b(?:full|whole|half|per|motor|motor's|gear's|one|two|three|of a|by a|than a) turns?\b"
        r"|\bturns? of the (?:motor|gear|bar|screw)\b|\bturn(?:s|ed)? (?:into|out to be|off)\b|\*turn\* is a unit",
    ),
    Rule(r"\blean(?:s|ed|ing)?\b", "tilt", "The joint leans under load."),
    Rule(r"\b(?:gives?|gave|giving) way\b", "deflection", "The gear gives way under load."),
    Rule(
        r"\bas (?:it (?:was|is) |they (?:were|are) )?drawn\b|\bdrawn (?:arm|robot|chain|geometry)\b"
        r"|\b(?:robot|arm|chain|joints?) (?:as )?drawn\b|\b(?:the|a|no) drawing\b",
        "nominal", "The arm as drawn is 1 mm off.",
        # A pencil draws on a sheet, and chance draws samples.
        "Poses are drawn at random; the drawing on the sheet is scanned.",
        r"\b(?:the|a|no) drawing (?:on|of) the sheet\b",
    ),
    Rule(r"\bf(?:oo|ee)t\b", "base", "Gravity pulls at the foot of the robot."),
    Rule(
        r"\bbeams?\b", "link", "Each beam bends.",
        # A laser tracker measures along a beam of light.
        "The laser beam was interrupted; noise across the beam of the tracker.",
        r"\b(?:laser|interrupted|across the|tracker's) beams?\b",
    ),
    Rule(
        r"\bpedestals?\b", "base mount", "The pedestal tilts.",
        # The glossary says what a base mount may be.
        "Its base mount: a pedestal, a table.", r": a pedestal\b",
    ),
    Rule(r"\b(?:blind|null|unseen) directions?\b", "unobservable direction", "A null direction is left alone."),
    Rule(r"\bspare\b", "dependent parameter", "A spare element is held."),
    Rule(r"\bshort way\b", "fast path", "A plain setpoint goes the short way."),
    Rule(
        r"\bplay\b", "backlash", "The joint has play.",
        "Masses play no part here.", r"\bplays? (?:no|a) (?:part|role)\b",  # an idiom
    ),
    Rule(r"\bhunt(?:s|ing)?\b", "gap search", "The hunt names an effect."),
    Rule(r"\bfore(?:tells?|told|sees?|seen)\b", "predicted", "The error was foretold."),
    Rule(r"\blook-?alikes?\b", "alias", "Its look-alike does as well."),
    Rule(
        r"\bworlds?\b", "world", "Kilter is used all over the world.",
        # The one sense that is left: the frame of the measuring device.
        "The world is the frame of the measuring device: its pose in the world, the world frame.",
        r"\bin the world\b|\bworld frame\b|\bthe world is the frame\b|\| world \|",
    ),
    Rule(
        r"\bframes? of the stream\b|\b(?:zenoh|stream(?:'s)?|damaged|bad|forged) frames?\b", "message",
        "A million damaged frames.", "A damaged message; the frame of the base.",
    ),
    Rule(r"\bpandas frames?\b", "frame", "Give a pandas frame.", "Give a pandas DataFrame."),
    # Plain English: what is of another language.
    Rule(
        r"(?<!there )\b(?:is|are|was|were|be) no (?!longer|more|less|fewer|larger|smaller|shorter|better|worse|later"
        r"|further|farther|nearer|higher|lower|faster|slower|newer|older|different|one\b)\w+", "",
        "The file is no JSON.", "The file is not JSON. There is no file. It is no larger than that.",
    ),
    Rule(r"\bneeds? it not\b|\bknows? it not\b", "", "SVG needs it not.", "SVG does not need it."),
    Rule(r"\bat the first time\b", "", "It is built at the first time.", "It is built the first time."),
    Rule(r"\balike by\b|\bin what there is\b", "", "They are alike by 0.84 in what there is.", "They correlate by 0.84."),
    Rule(r"\bkeeps? (?:\w+ ){1,5}true\b", "", "Kilter keeps an arm true.", "Kilter keeps an arm accurate."),
    Rule(r"\bin the place of\b", "", "A table in the place of a file.", "A table instead of a file."),
    Rule(r"\bgo(?:es)? before\b", "", "The option goes before the file.", "The option takes precedence over the file."),
    Rule(r"\band be it\b|\bof before\b", "", "Versions of before.", "Earlier versions."),
    # British spelling, as most of the pages had it.
    Rule(
        r"\b(?:colors?|behaviors?|centers?|centered|(?:milli|centi|micro)?meters|favor|gray|modeling"
        r"|(?:analy|recogni|lineari|normali|minimi|optimi|initiali|summari|organi|characteri)z(?:e[sd]?|ing|ation))\b",
        "", "The center is linearized.", "The centre is linearised.", areas=("docs",),
    ),
)  # fmt: skip
ANY_RULE = re.compile("|".join(f"(?:{rule.refused})" for rule in RULES), re.IGNORECASE)


def files(area: str) -> Iterator[Path]:
    endings = (".md",) if area == "docs" else (".py", ".m", ".c", ".h", ".toml", ".html", ".js")
    for part in AREAS[area]:
        path = REPOSITORY / part
        for found in [path] if path.is_file() else sorted(path.rglob("*")):
            name = str(found.relative_to(REPOSITORY))
            if found.suffix in endings and not name.startswith(GENERATED):
                yield found


def empty_lines(match: re.Match[str]) -> str:
    return "\n" * match.group().count("\n")


def prose_of_page(text: str) -> str:
    """A page without code, addresses of links, and what `make contract` writes into it; lines stay where they are."""
    text = re.sub(FENCE + r"|<!-- make contract:.*?<!-- end -->", empty_lines, text, flags=re.M | re.S)
    text = re.sub(r"`[^`\n]*`|\]\([^)\s]*\)", " x ", text)
    return re.sub(r"\n(?=[a-z(*])", " \n", text)


def prose_of_code(text: str) -> Iterator[tuple[int, str]]:
    """Docstrings, other strings of several words, and comments, with the line on which each begins."""
    for node in nodes(ast.parse(text)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value.strip():
            yield node.lineno, re.sub(r"``?[^`]*``?|'turn'|--[\w-]+|^ +\w+: ", " x ", node.value, flags=re.M)
    for line, comment in comments(text):
        yield line, re.sub(r"`[^`]*`", " x ", comment)


# A string, in which a # begins no comment, or a comment: Python's own tokenizer takes 20 times as long.
STRING_OR_COMMENT = re.compile(
    r'"""(?:[^"\\]|\\.|"(?!""))*"""' r"|'''(?:[^'\\]|\\.|'(?!''))*'''"
    r'|"(?:[^"\\\n]|\\.)*"' r"|'(?:[^'\\\n]|\\.)*'|#[^\n]*", re.DOTALL
)  # fmt: skip


def comments(text: str) -> Iterator[tuple[int, str]]:
    """The comments of a Python source, with their lines."""
    line = at = 0
    for match in STRING_OR_COMMENT.finditer(text):
        if match.group().startswith("#"):
            line, at = line + text.count("\n", at, match.start()), match.start()
            yield line + 1, match.group()


def passages(path: Path) -> Iterator[tuple[int, str]]:
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".py":
        yield from prose_of_code(text)
    elif path.suffix == ".md":
        yield from paragraphs(prose_of_page(text))
    elif path.suffix == ".html":
        yield from enumerate(prose_of_template(text).splitlines(), 1)
    elif path.suffix == ".js":
        yield from ((n, " ".join(PROSE_OF_SCRIPT.findall(line))) for n, line in enumerate(text.splitlines(), 1))
    else:
        for number, line in enumerate(text.splitlines(), 1):
            yield from ((number, said) for said in re.findall(r"(?:%|//|/?\*|#)(.*)", line))


PROSE_OF_SCRIPT = re.compile(r"(?<!:)//.*|`[^`]* [^`]*`|\"[^\"]* [^\"]*\"")


def prose_of_template(text: str) -> str:
    """What a page says, without its tags and expressions; lines stay where they are."""
    text = re.sub(r"<(script|style)\b.*?</\1>|<[^>]*>|\{%.*?%\}|\{\{.*?\}\}", empty_lines, text, flags=re.S)
    return html.unescape(text)


def in_words(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])|_", " ", name).strip().lower()


def paragraphs(text: str) -> Iterator[tuple[int, str]]:
    """Paragraphs joined to one line each, because a phrase may run over the end of a line."""
    for match in re.finditer(r"[^\n]+(?:\n(?![|#\n]| *[-*] | *\d+\. )[^\n]+)*", text):
        yield text.count("\n", 0, match.start()) + 1, re.sub(r"\s+", " ", match.group())


@cache
def said_in(area: str) -> tuple[tuple[str, str], ...]:
    """Every passage of an area, on one line, with its place."""
    return tuple(
        (f"{path.relative_to(REPOSITORY)}:{line}", re.sub(r"\s+", " ", said))
        for path in files(area)
        for line, said in passages(path)
    )


@cache
def suspected_in(area: str) -> tuple[tuple[str, str], ...]:
    """The passages in which some rule finds something: few, so that not every rule has to read them all."""
    return tuple((place, said) for place, said in said_in(area) if ANY_RULE.search(said))


def refused(rule: Rule, area: str) -> list[str]:
    return [f"{place}: {word!r}" for place, said in suspected_in(area) for word in rule.found(said)]


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.wrong)
def test_no_word_stands_for_a_standard_term(rule: Rule) -> None:
    found = [place for area in rule.areas for place in refused(rule, area)]
    assert not found, f"write {rule.term or rule.fine!r}; docs/reference/glossary.md has the terms"


DEFINED = re.compile(r"^[ \t]*(?:async )?(?:def|class) (\w+)", re.MULTILINE)


@cache
def names_in_code() -> tuple[tuple[str, str], ...]:
    """Names of modules, functions and classes as words, with their modules."""
    modules = [path for area in ("core", "clients", "service") for path in files(area) if path.suffix == ".py"]
    return tuple(
        (path.relative_to(REPOSITORY).as_posix(), in_words(name))
        for path in modules
        for name in (path.stem, *DEFINED.findall(path.read_text(encoding="utf-8")))
    )


def test_few_names_have_a_word_that_a_term_replaces() -> None:
    rules = [rule for rule in RULES if rule.areas == MENDED]
    found = [
        (place, name)
        for place, name in names_in_code()
        if ANY_RULE.search(name) and any(rule.found(name) for rule in rules)
    ]
    known = {still: [place for place, name in found if still in name] for still in NAMES_STILL}
    assert not {still: places for still, places in known.items() if len(places) > NAMES_STILL[still]}
    assert not [place for place, name in found if not any(still in name for still in NAMES_STILL)]


@pytest.mark.parametrize(
    ("name", "words"),
    [("refuse_lookAlikes", "refuse look alikes"), ("ForeseenPoses", "foreseen poses"), ("_a_b", "a b")],
)
def test_a_name_is_read_as_words(name: str, words: str) -> None:
    assert in_words(name) == words


def test_templates_and_scripts_are_read_without_their_code() -> None:
    page = '<p title="a">The joint {{ leans }} leans</p>\n<script>turned</script>{% if turn %}'
    assert prose_of_template(page).split() == ["The", "joint", "leans"]
    assert PROSE_OF_SCRIPT.findall('turn("the joint leans") // and turns') == ['"the joint leans"', "// and turns"]


def test_comments_are_those_of_python() -> None:
    sources = [Path(__file__), *(REPOSITORY / "core/kilter_core/gap").rglob("*.py")]
    texts = [source.read_text(encoding="utf-8") for source in sources]
    texts.append('a = "#" # b\nc = \'\\\'#\'; d = """\n# "\n\\"""# """  # e\nf = r"\\"  # g\n')
    for text in texts:
        tokens = tokenize.generate_tokens(io.StringIO(text).readline)
        wanted = [(token.start[0], token.string) for token in tokens if token.type == tokenize.COMMENT]
        assert list(comments(text)) == wanted


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: rule.wrong)
def test_each_rule_refuses_its_word_and_no_other_sense(rule: Rule) -> None:
    assert rule.found(rule.wrong)
    assert not rule.found(rule.fine)


def terms() -> list[str]:
    page = (REPOSITORY / "docs/reference/glossary.md").read_text(encoding="utf-8")
    return re.findall(r"^\| (?!term |---)([^|]+?) \|", page, re.MULTILINE)


def test_the_glossary_has_every_term_that_replaces_a_word() -> None:
    known = terms()
    assert len(known) >= 60
    assert known == sorted(known, key=str.lower)
    assert not {rule.term for rule in RULES if rule.term} - set(known)


def long_lines(page: Path) -> list[str]:
    """Lines of prose beyond the limit; tables, code and a line of one unbreakable link or span are left alone."""
    lines = re.sub(FENCE, empty_lines, page.read_text(encoding="utf-8"), flags=re.M | re.S).splitlines()
    return [
        f"{page.relative_to(REPOSITORY)}:{number}"
        for number, line in enumerate(lines, 1)
        if len(line) > MOST_CHARACTERS and not line.startswith(("|", "<!--", "![", "#")) and " " in line.strip()
    ]


def test_lines_of_the_documentation_are_short() -> None:
    assert not [place for page in files("docs") for place in long_lines(page)]


if __name__ == "__main__":
    for wanted in sys.argv[1:] or AREAS:
        for each in RULES:
            for place in refused(each, wanted):
                print(place, "->", each.term or each.fine)
