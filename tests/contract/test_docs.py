"""The documentation is complete and holds together: links, settings, routes, commands, effects, errors, columns."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

from tools.contract.interface import promised_interface

REPOSITORY = Path(__file__).resolve().parents[2]
DOCS = REPOSITORY / "docs"
PAGES = sorted(
    [
        *DOCS.rglob("*.md"),
        REPOSITORY / "README.md",
        REPOSITORY / "CHANGELOG.md",
        REPOSITORY / "CONTRIBUTING.md",
        REPOSITORY / "SECURITY.md",
        REPOSITORY / "clients/python/README.md",
    ]
)
KINDS = ("Added", "Changed", "Fixed")
MOST_OF_A_CHANGE = 140
MOST_WORDS = 70_000
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")


def text_of(page: str) -> str:
    return (DOCS / page).read_text(encoding="utf-8")


def without_code(text: str) -> str:
    return re.sub(r"^ *```.*?^ *```", "", text, flags=re.MULTILINE | re.DOTALL)


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, made as the usual renderers make them."""
    headings = re.findall(r"^#+ (.+)$", without_code(page.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def internal_links(page: Path) -> Iterator[str]:
    for target in LINK.findall(without_code(page.read_text(encoding="utf-8"))):
        if "://" not in target and not target.startswith("mailto:"):
            yield target


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_internal_links_resolve(page: Path) -> None:
    broken = []
    for target in internal_links(page):
        path, _, anchor = target.partition("#")
        aim = (page.parent / path).resolve() if path else page
        if not aim.exists() or (anchor and anchor not in anchors(aim)):
            broken.append(target)
    assert not broken


def test_every_page_is_reached_from_the_index() -> None:
    reached, waiting = set[Path](), [DOCS / "README.md"]
    while waiting:
        page = waiting.pop()
        if page in reached:
            continue
        reached.add(page)
        aims = [(page.parent / target.partition("#")[0]).resolve() for target in internal_links(page)]
        waiting += [aim for aim in aims if aim.suffix == ".md" and aim.is_file() and aim.is_relative_to(DOCS)]
    assert set(DOCS.rglob("*.md")) <= reached


def test_words_written_by_hand_are_few() -> None:
    """Words with a letter, decisions and surprises too; what `make contract` and the laboratory write does not count."""
    made = {"cli.md", "job-options.md", "routes.md", "library.md", "library-types.md", "licences.md"}
    pages = [page for page in (*DOCS.rglob("*.md"), *DOCS.rglob("*.md.in")) if page.name not in made]
    texts = [page.read_text(encoding="utf-8") for page in pages]
    by_hand = [re.sub(r"<!-- make contract: .+? -->.*?<!-- end -->", "", text, flags=re.DOTALL) for text in texts]
    words = sum(bool(re.search("[A-Za-z]", word)) for text in by_hand for word in text.split())
    assert words <= MOST_WORDS, f"{words} words: shorten a page"


def test_every_picture_is_used() -> None:
    used = {
        (page.parent / target).resolve()
        for page in PAGES
        for target in internal_links(page)
        if target.endswith((".svg", ".png"))
    }
    assert set((DOCS / "images").iterdir()) == used


def test_pages_name_no_place_outside_the_repository() -> None:
    for page in PAGES:
        assert "/work/" not in page.read_text(encoding="utf-8"), page


def test_decisions_are_numbered_and_listed() -> None:
    pages = sorted(path.name for path in (DOCS / "decisions").glob("0*.md"))
    assert [name[:4] for name in pages] == [f"{number:04}" for number in range(1, len(pages) + 1)]
    index = text_of("decisions/README.md")
    assert all(f"({name})" in index for name in pages)
    for name in pages:
        text = text_of(f"decisions/{name}")
        assert all(f"\n## {part}\n" in text for part in ("Context", "Decision", "Consequences")), name
        stands = re.match(r"# \d{4} .+\n\n(Accepted|Rejected|Replaced by \d{4}), (\d{4}-\d\d-\d\d)\.\n\n", text)
        assert stands, f"{name} does not say how it stands, and since when"
        date.fromisoformat(stands.group(2))


def test_the_citation_names_this_software_and_the_thesis() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    cited = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors", "version", "license", "references"} <= set(cited)
    assert (cited["version"], cited["license"]) == (project["version"], project["license"])
    (thesis,) = cited["references"]
    assert thesis["type"] == "thesis"
    assert "Joints Tilting" in thesis["title"]


def test_the_guide_names_what_there_is() -> None:
    """Paths and make targets of CONTRIBUTING.md exist."""
    guide = (REPOSITORY / "CONTRIBUTING.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:core|service|clients|tests|docs|tools)/[\w./-]+)`", guide))
    assert len(named) > 10
    assert not [name for name in named if not (REPOSITORY / name).exists()]
    targets = set(re.findall(r"^([a-z-]+):", (REPOSITORY / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    assert set(re.findall(r"`make ([a-z-]+)`", guide)) <= targets


def test_every_setting_is_documented() -> None:
    from kilter_service.ground.settings import Settings

    page = text_of("reference/settings.md")
    missing = [name for name in Settings.model_fields if f"| `KILTER_{name.upper()}` |" not in page]
    assert not missing
    named = set(re.findall(r"^\| `KILTER_(\w+)`", page, re.MULTILINE)) - {"URL", "CA"}
    assert named == {name.upper() for name in Settings.model_fields}


def test_default_port_is_documented() -> None:
    from kilter_service.ground.settings import Settings

    port = Settings.model_fields["port"].default
    assert f"| `KILTER_PORT` | `{port}` |" in text_of("reference/settings.md")
    assert f"EXPOSE {port} " in (REPOSITORY / "Dockerfile").read_text()


def test_every_route_is_documented() -> None:
    # That this is the interface is held by test_openapi.py.
    paths = promised_interface()["paths"]
    routes = {f"{method.upper()} {path}" for path, methods in paths.items() for method in methods}
    documented = {
        f"{method} {path}"
        for method, path in re.findall(r"^\| `(\w+) (/\S+)` \|", text_of("reference/routes.md"), re.M)
    }
    assert documented == routes


def test_every_effect_is_documented() -> None:
    from kilter_core.effects import EFFECTS

    documented = set(re.findall(r"^\| `(\w+)` \|", text_of("reference/effects.md"), re.MULTILINE))
    assert documented == set(EFFECTS)


def test_every_error_code_is_documented() -> None:
    from kilter_service.ground.errors import PROBLEMS

    page = text_of("reference/errors.md")
    documented = {code: int(status) for code, status in re.findall(r"^\| `(\w+)` \| (\d{3}) \|", page, re.MULTILINE)}
    assert documented == {code: status for code, (status, _) in PROBLEMS.items()}


def test_every_error_of_the_client_is_documented() -> None:
    from kilter_client import errors

    page = text_of("reference/errors.md")
    classes = [value for value in vars(errors).values() if isinstance(value, type) and issubclass(value, Exception)]
    missing = [found.__name__ for found in classes if f"`{found.__name__}`" not in page]
    assert not missing


def test_statuses_and_flags_of_the_stream_are_documented() -> None:
    from kilter_service.stream.corrector.wire import Flag, Status

    page = text_of("reference/stream.md")
    statuses = re.findall(r"^\| `(\w+)` \| (\d+) \|", page, re.MULTILINE)
    assert statuses == [(status.name, str(int(status))) for status in Status]
    flags = re.findall(r"^\| `(\w+)` \| (0x\w+) \|", page, re.MULTILINE)
    assert flags == [(flag.name, f"0x{int(flag):04x}") for flag in Flag]


def test_every_preset_is_documented() -> None:
    from kilter_core.arm.presets import preset_names

    page = text_of("reference/robots.md")
    assert not [name for name in preset_names() if f"`{name}`" not in page]


def commands(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    """Leaf commands; typer brings its own copy of click, so no class of click can be named here."""
    children = getattr(command, "commands", None)
    if children is None:
        yield name, command
        return
    for child, found in children.items():
        yield from commands(found, f"{name} {child}")


def test_every_client_command_and_option_is_documented() -> None:
    from kilter_client.cli import app

    page = text_of("reference/cli.md")
    missing = []
    for name, command in commands(typer.main.get_command(app), "kilter"):
        section = re.search(rf"^### `{re.escape(name)}.*?`\n(.*?)(?=^##|\Z)", page, re.MULTILINE | re.DOTALL)
        if section is None:
            missing.append(name)
            continue
        flags = {parameter.opts[0] for parameter in command.params if parameter.opts[0].startswith("--")}
        missing += [f"{name} {flag}" for flag in sorted(flags - {"--help", "--json"}) if f"`{flag}" not in section[1]]
    assert not missing


@pytest.mark.parametrize("command", ["serve", "api", "worker", "corrector", "migrate"])
def test_every_server_command_is_documented(command: str) -> None:
    assert f"`kilterd {command}" in text_of("reference/cli.md")


def test_changelog_has_the_usual_form() -> None:
    text = (REPOSITORY / "CHANGELOG.md").read_text(encoding="utf-8")
    assert "\n## [Unreleased]\n" in text
    releases = re.split(r"^## ", text, flags=re.MULTILINE)[1:]
    for release in releases:
        head, *lines = [line for line in release.splitlines() if line]
        assert re.fullmatch(r"\[Unreleased\]|\[\d+\.\d+\.\d+\] - \d{4}-\d\d-\d\d", head), head
        assert len(lines) <= 40, f"{head}: {len(lines)} lines; join what belongs together"
        kinds = [line.removeprefix("### ") for line in lines if line.startswith("### ")]
        assert kinds == [kind for kind in KINDS if kind in kinds], f"{head}: join what has one heading"
    assert not [line for line in text.splitlines() if len(line.removeprefix("- ")) > MOST_OF_A_CHANGE]


def test_fragments_of_the_changelog_are_well_formed() -> None:
    for path in sorted((REPOSITORY / "changes").iterdir()):
        if path.name in ("README.md", "template.jinja"):
            continue
        assert re.fullmatch(r"[a-z0-9-]+\.(added|changed|fixed)\.md", path.name), f"{path.name}: NAME.added.md"
        text = path.read_text(encoding="utf-8")
        assert re.fullmatch(rf"\S.{{0,{MOST_OF_A_CHANGE - 1}}}\n", text), (
            f"{path.name}: one line of at most 140 letters"
        )
        assert not text.startswith("- "), f"{path.name}: the dash comes by itself"


def run_towncrier(folder: Path, *arguments: str) -> str:
    command = [sys.executable, "-m", "towncrier", "build", "--version", "9.9.9", "--date", "2027-01-02", *arguments]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_fragments_of_the_changelog_become_a_release(tmp_path: Path) -> None:
    assert run_towncrier(REPOSITORY, "--draft").startswith("## [9.9.9] - 2027-01-02\n")
    for name in ("pyproject.toml", "CHANGELOG.md"):
        shutil.copy(REPOSITORY / name, tmp_path)
    (tmp_path / "changes").mkdir()
    shutil.copy(REPOSITORY / "changes/template.jinja", tmp_path / "changes")
    for name, text in {"a.changed": "More.", "b.changed": "Breaking: less.", "c.added": "New."}.items():
        (tmp_path / f"changes/{name}.md").write_text(f"{text}\n")
    run_towncrier(tmp_path, "--yes")
    release = "\n## [9.9.9] - 2027-01-02\n\n### Added\n\n- New.\n\n### Changed\n\n- Breaking: less.\n- More.\n\n"
    assert release in (tmp_path / "CHANGELOG.md").read_text(encoding="utf-8")
    assert not list((tmp_path / "changes").glob("*.md"))


def test_no_table_of_options_is_written_by_hand() -> None:
    """Every row of the page on commands stands between the marks of `make contract`, which --check compares."""
    page = text_of("reference/cli.md")
    by_hand = re.sub(r"<!-- make contract: .+? -->\n.*?<!-- end -->", "", page, flags=re.DOTALL)
    assert not re.findall(r"^\|.*", by_hand, re.MULTILINE)


def test_every_command_has_one_section_with_its_help_and_its_options() -> None:
    from kilter_client.cli import app

    page = text_of("reference/cli.md")
    for name, command in commands(typer.main.get_command(app), "kilter"):
        sections = re.findall(
            rf"^### `{re.escape(name)}(?: [\[A-Z][^`]*| [a-z]+\|[^`]*)?`\n(.*?)(?=^##|\Z)", page, re.M | re.S
        )
        assert len(sections) == 1, name
        help_text = " ".join(command.help.split("\n\n")[0].split())
        assert help_text[:60].replace("...", "…") in " ".join(sections[0].split()), name
        options = [p for p in command.params if p.param_type_name == "option" and p.opts[0] not in ("--json", "--help")]
        assert ("| option | meaning |" in sections[0]) == bool(options), name
