#!/bin/sh
# Build .venv: usage make_environment.sh PYTHON. Every version comes from constraints.txt, the build tools included:
# they are installed first and pip is told not to fetch its own. Python's own pip is old, and takes twice the time to unpack
# what it has in its cache. Nothing is compiled to bytecode beforehand: two thirds of it are never imported.
set -eu
python=$1

if ! "$python" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' 2>/dev/null; then
    echo "Kilter needs Python 3.11 and '${python:-python3}' is not that. Install it, or name it: make setup PYTHON=/path/to/python3.11" >&2
    exit 1
fi

if ! "$python" -c 'import ensurepip, venv' 2>/dev/null; then
    # Debian keeps these two modules in a package of their own.
    if [ "$(id -u)" != 0 ] || ! command -v apt-get >/dev/null; then
        echo "Python's venv module is missing. Install it first (Debian, Ubuntu: apt-get install python3.11-venv)." >&2
        exit 1
    fi
    apt-get update -qq
    apt-get install -y -qq --no-install-recommends python3.11-venv
fi

echo "Setting up .venv: this takes a few minutes, once."
[ -x .venv/bin/python ] || "$python" -m venv .venv
pip() { .venv/bin/python -m pip "$@" --disable-pip-version-check --quiet --constraint constraints.txt; }
pip install --upgrade pip
pip install --no-compile hatchling editables
pip install --no-compile --no-build-isolation --editable ./core --editable ./clients/files --editable '.[cluster,dev,pdf,postgresql,tracing]' --editable 'clients/python[bridge,camera,files,meshes,notebook,plots,sheet,stream,tags]'
