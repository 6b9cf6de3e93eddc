#!/usr/bin/env bash
# The numeric tests as on five processors, one after the other: a line each. No test may rest on one
# processor's last bit. Arguments go to pytest: scripts/processors.sh -n 1.
#
# OPENBLAS_CORETYPE makes the matrix library of numpy and scipy take the code that it has for such a
# processor (where it has none, e.g. for Zen, that of a relative). PROCESSORS chooses others:
# PROCESSORS='Haswell Zen' scripts/processors.sh. NPY_DISABLE_CPU_FEATURES reaches numpy's own loops
# as well. RBTM_BENCH_DATA as in scripts/test.sh; PYTHON is .venv's, unless it is set.
set -euo pipefail
unset PYTHONPATH PYTHONHOME

repo=$(CDPATH='' cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)
python=${PYTHON:-$repo/.venv/bin/python}
cd -- "$repo"

if [ -z "${RBTM_BENCH_DATA:-}" ] && [ -d ../shared/data ]; then
    RBTM_BENCH_DATA=$(cd ../shared/data && pwd -P)
    export RBTM_BENCH_DATA
fi

tests=(
    tests/{core,backends,odometry,metrics,similarity,selection,guess,check,target,datasets}
    tests/calibration tests/report/test_intervals.py
    rbtm_bench/contract
    --ignore tests/calibration/test_calibrate_command.py
)
failed=0
log=$(mktemp)
trap 'rm -f -- "$log"' EXIT
for processor in ${PROCESSORS:-Haswell SkylakeX Zen Sandybridge Prescott}; do
    code=0
    OPENBLAS_CORETYPE=$processor "$python" -m pytest -n 2 --dist worksteal -m 'not slow' -q --tb=short \
        -rfE -p no:cacheprovider "${tests[@]}" "$@" >"$log" 2>&1 || code=$?
    printf '%-12s %s\n' "$processor" "$(tail -n 1 -- "$log")"
    if [ "$code" -ne 0 ]; then
        failed=1
        cat -- "$log"
    fi
done
exit "$failed"
