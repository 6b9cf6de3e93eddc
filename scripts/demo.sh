#!/usr/bin/env bash
# Set up, then the main job on the embedded data: results/demo/table.csv. Arguments go to demo.py.
set -euo pipefail
unset PYTHONPATH PYTHONHOME

repo=$(CDPATH='' cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)
bash "$repo/scripts/setup.sh"
python=$repo/.venv/bin/python
cd -- "$repo"

"$python" scripts/demo.py "$@"
