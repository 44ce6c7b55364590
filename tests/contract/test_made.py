"""What git does not hold is made where it is needed: by every build of the client, from the interface's snapshot alone."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from tools.contract.__main__ import MADE, REPOSITORY

TYPED = "clients/python/src/kilter_client/typed"


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a fresh clone has of the client and of what its types are made from."""
    root = tmp_path_factory.mktemp("clone")
    for folder in ("clients/python", "tools/contract"):
        shutil.copytree(REPOSITORY / folder, root / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for made in (root / TYPED).glob("[a-z]*"):
        made.unlink()
    for file in (".gitignore", "tests/contract/openapi.txt"):
        (root / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(REPOSITORY / file, root / file)
    subprocess.run(["git", "init", "--quiet", str(root)], check=True)
    return root


def build(folder: Path, kind: str, to: Path) -> Path:
    """Build the client in an interpreter that sees no package of Kilter but the one in the folder."""
    command = [sys.executable, "-m", "hatchling", "build", "--target", kind, "--directory", str(to)]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
    (found,) = to.glob("*.whl" if kind == "wheel" else "*.tar.gz")
    return found


def made_modules() -> set[str]:
    return {path.name for path in (REPOSITORY / TYPED).glob("*.py")}


def test_the_client_without_its_types_says_what_makes_them(checkout: Path) -> None:
    sources = f"{checkout / 'clients/python/src'}{os.pathsep}{REPOSITORY / 'clients/files'}"
    for statement in ("from kilter import IdentifyResult", "import kilter_client.cli.analyse"):
        done = subprocess.run(
            [sys.executable, "-c", statement],
            env={**os.environ, "PYTHONPATH": sources},
            capture_output=True,
            text=True,
            timeout=240,
            check=False,
        )
        assert done.returncode == 1
        assert "ImportError: The types of answers" in done.stderr
        assert "run `make setup`" in done.stderr


def test_a_wheel_from_a_plain_checkout_has_the_types(checkout: Path, tmp_path: Path) -> None:
    wheel = build(checkout / "clients/python", "wheel", tmp_path)
    names = {Path(name).name for name in zipfile.ZipFile(wheel).namelist() if "/typed/" in name}
    assert names == made_modules()


def test_a_wheel_from_an_sdist_has_the_types(checkout: Path, tmp_path: Path) -> None:
    shutil.copytree(checkout, tmp_path / "clone")
    sdist = build(tmp_path / "clone/clients/python", "sdist", tmp_path / "sdist")
    with tarfile.open(sdist) as archive:
        archive.extractall(tmp_path / "unpacked", filter="data")
    (folder,) = (tmp_path / "unpacked").iterdir()
    wheel = build(folder, "wheel", tmp_path / "wheel")
    names = {Path(name).name for name in zipfile.ZipFile(wheel).namelist() if "/typed/" in name}
    assert names == made_modules()


def test_git_ignores_what_is_made_and_nothing_else_of_its_folders(checkout: Path) -> None:
    made = [str(path.relative_to(REPOSITORY)) for files in MADE for path in files()]
    assert f"{TYPED}/option_texts.py" in made
    assert "docs/reference/cli.md" in made
    others = [f"{TYPED}/__init__.py", "docs/reference/effects.md", "docs/reference/cli.md.in"]
    done = subprocess.run(
        ["git", "check-ignore", *made, *others], cwd=checkout, capture_output=True, text=True, check=False
    )
    assert done.stdout.split() == made
