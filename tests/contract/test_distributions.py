"""The four distributions: what each asks for, what its wheel installs, and that it works where nothing else is."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
import zipfile
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.version import Version

REPOSITORY = Path(__file__).resolve().parents[2]
FOLDERS = {"kilter": ".", "kilter-core": "core", "kilter-files": "clients/files", "kilter-client": "clients/python"}
TOP_LEVEL = {
    "kilter": {"kilter_service"}, "kilter-core": {"kilter_core"}, "kilter-files": {"kilter_files"},
    "kilter-client": {"kilter", "kilter_client"},
}  # fmt: skip
PYTHONS = ["3.11", "3.12", "3.13"]


def project(name: str) -> dict[str, Any]:
    found: dict[str, Any] = tomllib.loads((REPOSITORY / FOLDERS[name] / "pyproject.toml").read_text())["project"]
    return found


def for_users(name: str) -> list[Requirement]:
    """Return what users install; the tools of developers are pinned and not bounded."""
    found = project(name)
    extras = found.get("optional-dependencies", {}).items()
    texts = found["dependencies"] + [text for extra, more in extras if extra != "dev" for text in more]
    return [Requirement(text) for text in texts]


def bounded(name: str) -> list[Requirement]:
    return [one for one in for_users(name) if one.name not in FOLDERS]


def lower(requirement: Requirement) -> Version:
    bounds = [Version(one.version) for one in requirement.specifier if one.operator == ">="]
    assert len(bounds) == 1, f"{requirement}: state the oldest version that works"
    return bounds[0]


@pytest.mark.parametrize("name", FOLDERS)
def test_every_dependency_has_a_lower_bound_that_the_pinned_version_meets(name: str) -> None:
    lines = (REPOSITORY / "constraints.txt").read_text().split()
    pinned = {re.sub(r"[-_.]+", "-", pin).lower(): version for pin, version in (line.split("==") for line in lines)}
    for requirement in bounded(name):
        assert lower(requirement) <= Version(pinned[requirement.name.lower()])
        assert requirement.specifier.contains(pinned[requirement.name.lower()])


def test_the_distributions_agree_on_what_they_share() -> None:
    bounds = defaultdict(set)
    for name in FOLDERS:
        for requirement in bounded(name):
            bounds[requirement.name].add(lower(requirement))
    assert all(len(found) == 1 for found in bounds.values()), bounds


def test_they_are_released_together() -> None:
    (version,) = {project(name)["version"] for name in FOLDERS}
    own = [one for name in FOLDERS for one in for_users(name) if one.name in FOLDERS]
    assert {one.name for one in own} == {"kilter-core", "kilter-files"}
    assert all(one.specifier.contains(version) for one in own)
    assert str(project("kilter")["dependencies"]).count(f"=={version}") == 2


@pytest.mark.parametrize(
    ("file", "pattern"),
    [
        ("CHANGELOG.md", r"^## \[(\d.+)\] - "),  # the newest
        ("CITATION.cff", r"^version: (.+)$"),
        ("Dockerfile", r'image\.version="(.+)"'),
        ("clients/ros2_control/package.xml", r"<version>(.+)</version>"),
        ("clients/python/src/kilter_client/cli/quick_start.py", r'^SOURCE_TREE = "(.+)\+source"'),
        ("service/kilter_service/ground/settings.py", r'^SOURCE_TREE = "(.+)\+source"'),
        ("docs/how-to/run-on-several-machines.md", r'"registry/kilter:(.+?)"'),
    ],
)
def test_the_release_is_the_same_wherever_it_stands(file: str, pattern: str) -> None:
    found = re.search(pattern, (REPOSITORY / file).read_text(encoding="utf-8"), re.MULTILINE)
    assert found
    assert found[1] == project("kilter")["version"]


@pytest.mark.parametrize("name", FOLDERS)
def test_the_pythons_are_named_and_no_other_is_taken(name: str) -> None:
    found = project(name)
    named = [text.rpartition(" :: ")[2] for text in found["classifiers"] if "Python :: 3." in text]
    assert named == PYTHONS
    taken = SpecifierSet(found["requires-python"])
    assert [f"3.{minor}" for minor in range(8, 20) if taken.contains(f"3.{minor}.0")] == PYTHONS


def test_the_plug_in_for_lerobot_has_the_name_that_lerobot_looks_for_and_is_released_with_the_others() -> None:
    """It is installed beside LeRobot, on Pythons that LeRobot takes; `python -m tools.lab lerobot` runs it there."""
    found = tomllib.loads((REPOSITORY / "clients/lerobot/pyproject.toml").read_text())["project"]
    assert found["name"].startswith("lerobot_robot_")
    assert found["version"] == project("kilter")["version"]
    taken = SpecifierSet(found["requires-python"])
    assert [python for python in PYTHONS if taken.contains(f"{python}.0")] == ["3.12", "3.13"]
    needs = {one.name: one for one in map(Requirement, found["dependencies"])}
    assert all(needs[name].specifier.contains(found["version"]) for name in ("kilter-client", "kilter-files"))
    pins = dict(line.split("==") for line in (REPOSITORY / "tests/clients/lerobot/constraints.txt").read_text().split())
    assert needs["lerobot"].specifier.contains(pins["lerobot"])


def test_a_python_that_is_not_here_is_skipped_in_words() -> None:
    done = subprocess.run(
        ["sh", "tools/test_pythons.sh", "3.99"], cwd=REPOSITORY, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (0, "Python 3.99: skipped, it is not on this machine\n"), done.stderr
    assert re.search(rf"set -- {' '.join(PYTHONS)}$", (REPOSITORY / "tools/test_pythons.sh").read_text(), re.MULTILINE)


@pytest.fixture(scope="module")
def wheels(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Every wheel, built from the sources as they are."""
    folder = tmp_path_factory.mktemp("dist")
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps"]
    sources = [f"./{path}" for path in FOLDERS.values()]
    subprocess.run(
        [*pip, "--no-build-isolation", "--wheel-dir", str(folder), *sources], cwd=REPOSITORY, check=True, timeout=240
    )
    return {name: next(folder.glob(f"{name.replace('-', '_')}-[0-9]*.whl")) for name in FOLDERS}


@pytest.mark.parametrize("name", FOLDERS)
def test_a_wheel_brings_its_own_module_and_no_other(name: str, wheels: dict[str, Path]) -> None:
    names = [Path(path) for path in zipfile.ZipFile(wheels[name]).namelist()]
    assert {path.parts[0] for path in names if not path.parts[0].endswith(".dist-info")} == TOP_LEVEL[name]
    assert {f"{module}/py.typed" for module in TOP_LEVEL[name]} <= {str(path) for path in names}
    if name == "kilter":
        revisions = sorted(path.name for path in (REPOSITORY / "migrations/versions").glob("2*.py"))
        assert sorted(path.name for path in names if path.match("kilter_service/migrations/versions/*.py")) == revisions


USE = """
import os, sys
from pathlib import Path
site = Path(sys.argv[1])
import kilter, kilter_client, kilter_core, kilter_files, kilter_service
for package in (kilter, kilter_client, kilter_core, kilter_files, kilter_service):
    assert Path(package.__file__).is_relative_to(site), package.__file__
from kilter_core.arm.documents import robot_from_document
from kilter_core.arm.presets import preset_document, preset_names
for name in preset_names():
    robot_from_document({"name": "arm", **preset_document(name)})
from kilter_files import prepare
Path("a.csv").write_text("q1_deg,x_mm,y_mm,z_mm\\n1,2,3,4\\n")
assert prepare("a.csv").content
from kilter_client.cli import main as command
from kilter_service.__main__ import main as server
server(["migrate", "--data", "data"])
assert Path("data/kilter.sqlite").is_file(), os.listdir("data")
"""


def test_the_wheels_work_from_an_empty_folder(wheels: dict[str, Path], tmp_path: Path) -> None:
    """The sources are not in reach: what a wheel lacks is missing here. `make wheels` goes on to a server and a fit."""
    site, folder = tmp_path / "site", tmp_path / "empty"
    for wheel in wheels.values():
        zipfile.ZipFile(wheel).extractall(site)
    folder.mkdir()
    environment = {**os.environ, "PYTHONPATH": str(site), "PYTHONSAFEPATH": "1"}
    done = subprocess.run(
        [sys.executable, "-c", USE, str(site)], cwd=folder, env=environment, capture_output=True, text=True,
        timeout=240, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
