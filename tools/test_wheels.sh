#!/bin/sh
# Run the suite from the wheels that `make wheels` built and installed: usage test_wheels.sh [TEST...]. The sources of the
# packages are not in reach: the tests run in a copy of what is beside them. Kilter's distributions come from dist/ by path,
# what the tests need has the versions of constraints.txt.
set -eu
[ $# -gt 0 ] || set -- tests/core tests/service tests/clients tests/corrector
python=$PWD/build/wheels/bin/python
[ -x "$python" ] || { echo "build/wheels is missing: run make wheels first." >&2; exit 1; }
pip() { "$python" -m pip "$@" --disable-pip-version-check --quiet --constraint constraints.txt; }
pip install coverage ezc3d hypothesis packaging pin psycopg 'psycopg[binary]' pytest pytest-timeout pytest-xdist pyyaml
pip install --find-links dist 'kilter-client[files,plots,sheet,stream]'
rm -rf build/suite
mkdir -p build/suite/clients
cp -r tests tools docs examples benchmarks README.md Makefile CHANGELOG.md changes CITATION.cff pyproject.toml constraints.txt build/suite/
cp -r clients/matlab build/suite/clients/
mkdir -p build/suite/clients/python
cp -r clients/python/examples clients/python/README.md build/suite/clients/python/
cp -r migrations build/suite/
export KILTER_SHARED_DATA="${KILTER_SHARED_DATA:-$PWD/../shared/data}"
cd build/suite
"$python" -m pytest -q -n "${TESTERS:-2}" --dist loadscope "$@"
