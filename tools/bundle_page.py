"""Bundle the page's scripts and styles: ``python -m tools.bundle_page [--check]`` writes service/kilter_service/page/static.

Needs Node.js with npm, on the machine of whoever changes the page only: what it writes is kept in the repository. With
``--check`` nothing is built; what is there is compared with the sources by their hashes.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import subprocess
import sys
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parent.parent
PAGE = REPOSITORY / "service" / "kilter_service" / "page"
SOURCES, STATIC, BUILD = PAGE / "sources", PAGE / "static", REPOSITORY / "build" / "page"
# Scripts of several files are modules; the theme is set before anything is drawn, so it is none.
ENTRIES = {
    "page.js": "esm",
    "plot.js": "esm",
    "arm.js": "esm",
    "series.js": "esm",
    "stream.js": "esm",
    "theme.js": "iife",
    "page.css": "css",
    "report.css": "css",
    "icon.svg": "",
}
NPM = ("npm", "install", "--no-package-lock", "--no-audit", "--no-fund", "--loglevel=error")


def hashes() -> dict[str, str]:
    """SHA-256 of every source."""
    found = sorted(path for path in SOURCES.rglob("*") if path.is_file())
    return {str(path.relative_to(SOURCES)): hashlib.sha256(path.read_bytes()).hexdigest() for path in found}


def bundle() -> dict[str, str]:
    """Write the hashed files; returns the file of each name."""
    BUILD.mkdir(parents=True, exist_ok=True)
    shutil.copytree(SOURCES, BUILD, dirs_exist_ok=True)
    subprocess.run(NPM, cwd=BUILD, check=True)
    shutil.rmtree(STATIC, ignore_errors=True)
    STATIC.mkdir()
    named = {}
    for entry, form in ENTRIES.items():
        if not (SOURCES / entry).exists():
            continue
        content = _bundled(entry, form) if form else (SOURCES / entry).read_bytes()
        path = Path(entry)
        named[entry] = f"{path.stem}.{hashlib.sha256(content).hexdigest()[:12]}{path.suffix}"
        (STATIC / named[entry]).write_bytes(content)
    return named


def _bundled(entry: str, form: str) -> bytes:
    out = BUILD / "out" / entry
    command = [str(BUILD / "node_modules" / ".bin" / "esbuild"), entry, "--bundle", "--minify", f"--outfile={out}"]
    command += ["--legal-comments=inline", "--log-level=warning", "--loader:.css=css", "--target=es2022"]
    subprocess.run([*command, *([f"--format={form}"] if form != "css" else [])], cwd=BUILD, check=True)
    return out.read_bytes()


def licences() -> str:
    """Texts of the licences of what is bundled."""
    needed = json.loads((SOURCES / "package.json").read_text())["dependencies"]
    parts = []
    for name, version in sorted(needed.items()):
        folder = BUILD / "node_modules" / name
        text = next(path for path in sorted(folder.iterdir()) if path.stem.upper() in ("LICENSE", "LICENCE"))
        parts.append(f"{name} {version}\n\n{text.read_text(encoding='utf-8').strip()}\n")
    return "\n\n".join(parts)


def stale() -> list[str]:
    """Sources that differ from those of the files that are kept."""
    kept = json.loads((STATIC / "manifest.json").read_text())["sources"] if (STATIC / "manifest.json").exists() else {}
    now = hashes()
    return sorted(name for name in {*kept, *now} if kept.get(name) != now.get(name))


def main() -> None:
    """Bundle, or compare."""
    if "--check" in sys.argv[1:]:
        if changed := stale():
            raise SystemExit(f"The page's files are not of these sources: {', '.join(changed)}. Run `make page`.")
        return
    if shutil.which("npm") is None:
        raise SystemExit("Bundling the page needs Node.js with npm (Debian: apt-get install npm).")
    named = bundle()
    (STATIC / "LICENCES.txt").write_text(licences(), encoding="utf-8")
    text = json.dumps({"files": named, "sources": hashes()}, indent=2)
    (STATIC / "manifest.json").write_text(f"{text}\n", encoding="utf-8")
    for name, file in named.items():
        print(f"{name}\t{(STATIC / file).stat().st_size} bytes")


if __name__ == "__main__":
    main()
