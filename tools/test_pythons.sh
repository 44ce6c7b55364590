#!/bin/sh
# Run the quick part of the suite on every Python that Kilter supports and this machine has: usage test_pythons.sh [VERSION...].
# Each gets an environment of its own in build/, with the versions of constraints.txt; "oldest" is Python 3.11 with the oldest
# version of every dependency that the distributions allow. What is missing is named.
set -eu
[ $# -gt 0 ] || set -- 3.11 3.12 3.13
QUICK="tests/core tests/service/test_jobs.py tests/clients/test_cli.py tests/corrector/test_stream.py"
# A shim of pyenv is there for every version and runs those that are switched on only: the interpreter itself is asked.
find_python() {
    for found in "$(command -v "python$1" || true)" "$HOME"/.pyenv/versions/"$1".*/bin/python; do
        if [ -x "$found" ] && "$found" -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$1')" 2>/dev/null; then
            echo "$found"
            return
        fi
    done
}
mkdir -p build
for version in "$@"; do
    constraints=constraints.txt needed=$version
    if [ "$version" = oldest ]; then
        constraints=build/oldest.txt needed=3.11
        .venv/bin/python -m tools.oldest_versions >"$constraints"
    fi
    python=$(find_python "$needed")
    if [ -z "$python" ]; then
        echo "Python $needed: skipped, it is not on this machine"
        continue
    fi
    home=build/python$version
    [ -x "$home/bin/python" ] || "$python" -m venv "$home"
    pip() { "$home/bin/python" -m pip "$@" --disable-pip-version-check --quiet --constraint "$constraints"; }
    # Old versions come as sources, which want setuptools and wheel.
    pip install hatchling editables setuptools wheel pytest pytest-timeout pytest-xdist hypothesis ezc3d packaging pin
    pip install --no-build-isolation --editable ./core --editable ./clients/files --editable '.[postgresql]' \
        --editable 'clients/python[camera,files,meshes,notebook,plots,sheet,stream,tags]'
    echo "Python $version, SQLite $("$home/bin/python" -c 'import sqlite3; print(sqlite3.sqlite_version)'):"
    # Kernels compiled by one Python are of no use to another, and their folder is that of the sources.
    NUMBA_CACHE_DIR="$PWD/build/kernels$version" "$home/bin/python" -m pytest -q -n "${TESTERS:-2}" --dist loadscope $QUICK
done
