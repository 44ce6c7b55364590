#!/bin/sh
# Build every wheel into dist/, install them in a fresh environment and use them there: usage make_wheels.sh PYTHON.
# Kilter's own distributions come from the files in dist/ only, named by path; what they need has the versions of
# constraints.txt. The build tools are those of .venv.
set -eu
python=$1
rm -rf dist build/wheels
.venv/bin/python -m pip wheel --disable-pip-version-check --quiet --no-deps --no-build-isolation --wheel-dir dist ./core ./clients/files . ./clients/python
"$python" -m venv build/wheels
build/wheels/bin/python -m pip install --disable-pip-version-check --quiet --constraint constraints.txt dist/*.whl
# The examples are the tutorial's; -I keeps this folder's own sources away, which are called as what is installed.
build/wheels/bin/python -I tools/try_wheels.py docs/tutorial
# The client without a server says what to install.
build/wheels/bin/python -m pip uninstall --yes --quiet kilter
build/wheels/bin/kilter demo 2>&1 | grep "install the wheels of kilter"
