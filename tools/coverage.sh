#!/bin/sh
# Count the lines that the tests run. The kernels run compiled, where no line is counted: their tests run once more without the
# compiler. Then numpy warns of overflows that the compiled code passes over, as it should: a rotation by an infinite cotangent
# is by nothing.
set -eu
coverage=.venv/bin/coverage arm=tests/core/arm corrector=tests/corrector
$coverage erase
$coverage run -m pytest -n "${TESTERS:-6}" --dist loadscope "$@"
NUMBA_DISABLE_JIT=1 $coverage run -m pytest -q -W ignore::RuntimeWarning $arm/test_chain.py $arm/test_moments.py \
    tests/core/observations/test_poses.py $corrector/test_kernel.py $corrector/test_load_chain.py
$coverage combine -q
$coverage report
