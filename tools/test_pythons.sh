#!/bin/sh
# Run the quick part of the suite on every Python that Kilter supports and this machine has: usage test_pythons.sh [VERSION...].
# Each gets an environment of its own in build/, with the versions of constraints.txt. What is missing is named.
set -eu
[ $# -gt 0 ] || set -- 3.11 3.12 3.13
QUICK="tests/core tests/service/test_engine_clock.py tests/service/test_jobs.py"
# A shim of pyenv is there for every version and runs those that are switched on only: the interpreter itself is asked.
find_python() {
    for found in "$(command -v "python$1" || true)" "$HOME"/.pyenv/versions/"$1".*/bin/python; do
        if [ -x "$found" ] && "$found" -c "import sys; sys.exit('%d.%d' % sys.version_info[:2] != '$1')" 2>/dev/null; then
            echo "$found"
            return
        fi
    done
}
for version in "$@"; do
    python=$(find_python "$version")
    if [ -z "$python" ]; then
        echo "Python $version: skipped, it is not on this machine"
        continue
    fi
    home=build/python$version
    [ -x "$home/bin/python" ] || "$python" -m venv "$home"
    pip() { "$home/bin/python" -m pip "$@" --disable-pip-version-check --quiet --constraint constraints.txt; }
    pip install hatchling editables pytest pytest-timeout pytest-xdist hypothesis ezc3d packaging pin
    pip install --no-build-isolation --editable '.[postgresql]' --editable 'clients/python[files,notebook,plots,sheet,stream]'
    echo "Python $version, SQLite $("$home/bin/python" -c 'import sqlite3; print(sqlite3.sqlite_version)'):"
    # Kernels compiled by one Python are of no use to another, and their folder is that of the sources.
    NUMBA_CACHE_DIR="$PWD/build/kernels$version" "$home/bin/python" -m pytest -q -n "${TESTERS:-2}" --dist loadscope $QUICK
done
