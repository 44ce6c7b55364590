#!/bin/sh
# Build .venv-lerobot with LeRobot and the distributions of Kilter that its plug-in needs: usage lerobot_environment.sh PINS.
set -eu
pins=$1
# A shim of pyenv is there for every version and runs those that are switched on only: the interpreter itself is asked.
for python in "$(command -v python3.12 || true)" "$HOME"/.pyenv/versions/3.12.*/bin/python; do
    if [ -x "$python" ] && "$python" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 12))' 2>/dev/null; then
        [ -x .venv-lerobot/bin/python ] || "$python" -m venv .venv-lerobot
        pip() { .venv-lerobot/bin/python -m pip "$@" --disable-pip-version-check --quiet --constraint "$pins"; }
        pip install hatchling editables 'lerobot[feetech]' eclipse-zenoh httpx numba rich scipy typer
        pip install --no-build-isolation --no-deps --editable ./core --editable ./clients/files --editable ./clients/python \
            --editable ./clients/lerobot
        exit 0
    fi
done
echo "LeRobot needs Python 3.12, and this machine has none." >&2
exit 1
