#!/usr/bin/env bash
# Set up, then lint, format, types and tests. Arguments go to pytest: scripts/test.sh -m 'not slow'.
#
# Tests on real data read the folder RBTM_BENCH_DATA; unset, it is ../shared/data where that exists.
set -euo pipefail
unset PYTHONPATH PYTHONHOME

repo=$(CDPATH='' cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)
bash "$repo/scripts/setup.sh" dev
python=$repo/.venv/bin/python
cd -- "$repo"

if [ -z "${RBTM_BENCH_DATA:-}" ] && [ -d ../shared/data ]; then
    RBTM_BENCH_DATA=$(cd ../shared/data && pwd -P)
    export RBTM_BENCH_DATA
fi
printf 'test: RBTM_BENCH_DATA=%s\n' "${RBTM_BENCH_DATA:-(unset: no tests on real data)}"

"$python" -m ruff check .
"$python" -m ruff format --check .
"$python" -m mypy rbtm_bench
"$repo/.venv/bin/lint-imports" --no-cache
# worksteal: each worker begins with one half in order, so that few fixtures are made twice
"$python" -m pytest -n 2 --dist worksteal "$@"
