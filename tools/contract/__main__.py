"""Write everything that says again what the contract or the core's effects say, or check that it is up to date."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from tools.contract.client_types import client_modules
from tools.contract.effects import effects_data
from tools.contract.interface import promised_interface
from tools.contract.methods import methods_module

REPOSITORY = Path(__file__).resolve().parents[2]
PAGES = (
    "docs/reference/cli.md",
    "docs/reference/job-options.md",
    "docs/reference/routes.md",
    "docs/reference/effects.md",
    "docs/how-to/from-your-files.md",
)
TYPED = "clients/python/src/kilter_client/typed"
MATLAB = ("identify", "gap", "evaluate", "plan")


def modules() -> dict[Path, str]:
    """Return what the contract itself takes from the core as it should be."""
    texts = {
        "service/kilter_service/contract/effects.json": effects_data(),
        "service/kilter_service/contract/methods.py": formatted(methods_module()),
    }
    return {REPOSITORY / name: text for name, text in texts.items()}


def tables() -> dict[Path, str]:
    """Return whatever repeats the contract as it should be."""
    from tools.contract.lists import lists_text
    from tools.contract.tables import command_texts, with_help, with_tables  # imports the modules, which must stand

    client = "clients/python/src/kilter_client/cli"
    texts = {f"{client}/texts/option_texts.py": formatted(command_texts())}
    texts[f"{client}/texts/lists.json"] = lists_text()
    made = client_modules(promised_interface())
    texts |= {f"{TYPED}/{module}.py": formatted(text) for module, text in made.items()}
    texts |= {page: with_tables(read(page)) for page in PAGES}
    texts |= {
        f"clients/matlab/+kilter/{kind}.m": with_help(kind, read(f"clients/matlab/+kilter/{kind}.m")) for kind in MATLAB
    }
    return {REPOSITORY / name: text for name, text in texts.items()}


def library() -> dict[Path, str]:
    """Return the reference of the Python library as it should be; a process of its own sees the types just written."""
    done = subprocess.run(
        [sys.executable, "-m", "tools.contract.library"], capture_output=True, text=True, check=True, cwd=REPOSITORY
    )
    return {REPOSITORY / "docs/reference" / name: text for name, text in json.loads(done.stdout).items()}


def stale(files: Mapping[Path, str], check: bool) -> bool:
    """Write, or name with ``check``, what is not up to date; whether anything was."""
    old = [path for path, text in files.items() if not path.exists() or path.read_text(encoding="utf-8") != text]
    for path in old:
        if check:
            print(f"{path.relative_to(REPOSITORY)} is not what the contract says: run make contract.", file=sys.stderr)
        else:
            path.write_text(files[path], encoding="utf-8")
    return bool(old)


def read(name: str) -> str:
    """Return the text of a file of the repository."""
    return (REPOSITORY / name).read_text(encoding="utf-8")


def formatted(module: str) -> str:
    """Return a module as the formatter leaves it."""
    ruff = str(Path(sys.executable).with_name("ruff"))
    done = subprocess.run(
        [ruff, "format", "-"], input=module, capture_output=True, text=True, check=True, cwd=REPOSITORY
    )
    return done.stdout


def main() -> int:
    """Write, or compare with --check; 1 when something is not up to date."""
    parser = argparse.ArgumentParser(prog="python -m tools.contract", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing, say what is not up to date")
    check = parser.parse_args().check
    found = [stale(made(), check) for made in (modules, tables, library)]
    return 1 if check and any(found) else 0


if __name__ == "__main__":
    sys.exit(main())
