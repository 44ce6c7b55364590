"""What the Python client has of the interface: types of answers, and the help of the options of jobs.

It is made from the snapshot of the interface alone, so that a wheel of the client can be built where nothing of the server is
installed: its build (clients/python/hatch_build.py) calls ``write_client``. Git does not hold it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tools.contract.client_types import client_modules, kinds_of_job
from tools.contract.interface import promised_interface

TYPED = Path(__file__).resolve().parents[2] / "clients/python/src/kilter_client/typed"


def client_files() -> dict[Path, str]:
    """Return the text of each module of ``kilter_client.typed`` that is made."""
    interface = promised_interface()
    texts = {**client_modules(interface), "option_texts": _option_texts(interface)}
    return {TYPED / f"{module}.py": text for module, text in texts.items()}


def write_client() -> None:
    """Write the modules that are missing or not what the interface says."""
    for path, text in client_files().items():
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def _option_texts(interface: Mapping[str, Any]) -> str:
    """The module with the help of the command's options: for each kind of job the text of each option."""
    lines = ['"""Help of the options of jobs, made from the interface by `make contract`: change it there."""\n']
    lines.append("from __future__ import annotations\n")
    for kind, job in kinds_of_job(interface).items():
        options = interface["components"]["schemas"][f"{job.removesuffix('Job')}Options"]["properties"]
        lines.append(f"{kind.upper()} = {{")
        lines += [f"    {name!r}: {plain_text(schema)!r}," for name, schema in options.items()]
        lines.append("}")
    return "\n".join(lines) + "\n"


def plain_text(schema: Mapping[str, Any]) -> str:
    """Return a description without the marks of a page, for where an option is not given instead of null."""
    return re.sub(r"\b(null|empty):", "left out:", str(schema["description"]).replace("`", ""))


if __name__ == "__main__":
    write_client()
