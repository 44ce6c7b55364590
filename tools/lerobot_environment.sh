#!/bin/sh
# Build .venv-lerobot with LeRobot and the distributions of Kilter that its plug-in needs: usage lerobot_environment.sh PINS.
set -eu
pins=$1
room_gb=9  # the environment has 5.5, and the wheels lie beside it while they are unpacked
# A shim of pyenv is there for every version and runs those that are switched on only: the interpreter itself is asked.
for python in "$(command -v python3.12 || true)" "$HOME"/.pyenv/versions/3.12.*/bin/python; do
    if [ -x "$python" ] && "$python" -c 'import sys; sys.exit(sys.version_info[:2] != (3, 12))' 2>/dev/null; then
        [ -x .venv-lerobot/bin/python ] || "$python" -m venv .venv-lerobot
        free_kb=$(df -Pk . | awk 'NR == 2 { print $4 }')
        if [ "$free_kb" -lt $((room_gb * 1000000)) ] && [ ! -d .venv-lerobot/lib/python3.12/site-packages/torch ]; then
            echo "LeRobot needs $room_gb GB of disk to be installed, and $((free_kb / 1000000)) GB are free here." >&2
            exit 1
        fi
        pip() { .venv-lerobot/bin/python -m pip "$@" --disable-pip-version-check --quiet; }
        # The list is whole, so nothing is resolved: a resolver asks every index about every package, one after the other.
        # A connection that stands still is given up after 30 s, whatever the machine is set to; most modules of PyTorch are
        # never imported, so none is compiled ahead.
        pip install --no-deps --no-compile --timeout 30 --requirement "$pins"
        pip install --no-build-isolation --no-deps --editable ./core --editable ./clients/files --editable ./clients/python \
            --editable ./clients/lerobot
        .venv-lerobot/bin/python -m pip check --disable-pip-version-check  # a package that the list lacks is named
        exit 0
    fi
done
echo "LeRobot needs Python 3.12, and this machine has none." >&2
exit 1
