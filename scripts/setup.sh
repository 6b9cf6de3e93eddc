#!/usr/bin/env bash
# Make .venv in this repository, with the system libraries it needs.
#
#   scripts/setup.sh        what running needs
#   scripts/setup.sh dev    and what testing needs
#
# The demo and the tests call it; a repeat with nothing to do takes less than a second.
# PYTHON=/path/to/python chooses the interpreter (3.11 or newer).
set -euo pipefail
unset PYTHONPATH PYTHONHOME # e.g. a sourced ROS would put its own packages before ours
export PIP_USER=0           # `user = true` in a pip configuration does not go with a .venv

say() { printf 'setup: %s\n' "$*" >&2; }
fail() { say "$@"; exit 1; }

repo=$(CDPATH='' cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd -P)
cd -- "$repo"
venv=$repo/.venv
stamp=$venv/.setup-done # what the last finished set-up was made for: repository, hash, kind
running='.[small-gicp]'
testing='.[small-gicp,bags,las,slurm,ray,dev]' # the launchers are tested for real
kind=${1:-run}
case $kind in
    run) requirement=$running ;;
    dev) requirement=$testing ;;
    *) fail "unknown kind \"$kind\"; usage: scripts/setup.sh [dev]" ;;
esac
hash=$(cat pyproject.toml constraints.txt | sha256sum | cut -d ' ' -f 1)

# library=Debian package, from what Open3D's shared objects link to and do not bring
libraries=(
    libEGL.so.1=libegl1
    libGL.so.1=libgl1
    libX11.so.6=libx11-6
    libidn2.so.0=libidn2-0
    libstdc++.so.6=libstdc++6
    libudev.so.1=libudev1
    libusb-1.0.so.0=libusb-1.0-0
)

# An interpreter of 3.11 or newer: PYTHON, else the usual names.
find_python() {
    local name
    for name in ${PYTHON:+"$PYTHON"} python3.11 python3 python3.12 python3.13; do
        if "$name" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
            command -v -- "$name"
            return
        fi
    done
    return 1
}

# The Debian packages that this machine lacks, one a line.
missing_packages() {
    "$1" - "${libraries[@]}" <<'PY'
import ctypes
import sys

for pair in sys.argv[1:]:
    library, package = pair.split("=")
    try:
        ctypes.CDLL(library)
    except OSError:
        print(package)
try:
    import ensurepip  # noqa: F401
except ImportError:
    print("python{}.{}-venv".format(*sys.version_info))
PY
}

# Install Debian packages where we may, else say what to type.
install_packages() {
    local as_root=()
    local -r command="apt-get install --no-install-recommends $*"
    command -v apt-get >/dev/null ||
        fail "this machine lacks what the Debian packages \"$*\" hold; install its counterparts"
    if [ "$(id -u)" != 0 ]; then
        sudo -n true 2>/dev/null || fail "these system packages are missing: $*
setup: install them as root, then run this again:
setup:     sudo apt-get update && sudo $command"
        as_root=(sudo -n)
    fi
    say "installing system packages: $*"
    "${as_root[@]}" apt-get update -qq || say "apt-get update failed; trying the lists at hand"
    "${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
        apt-get install -qq -y --no-install-recommends "$@" >/dev/null ||
        fail "apt-get failed (its words are above); the command was: $command"
}

# True where pip is told where to get packages from; uv would not hear of it.
pip_has_sources() {
    local settings
    settings=$("$venv/bin/python" -m pip config list)
    grep -Eq '(index-url|no-index|find-links|proxy|cert|trusted-host)=' <<<"$settings"
}

# uv takes a fifth of pip's time, so it comes first where nothing speaks against it.
install_python_packages() {
    local uv
    if ! pip_has_sources; then
        uv=$(command -v uv) || {
            "$venv/bin/python" -m pip install -qq -c constraints.txt uv || true
            uv=$venv/bin/uv
        }
        "$uv" pip install -q --python "$venv/bin/python" -c constraints.txt -e "$requirement" &&
            return
        say "uv could not do it; trying pip"
    fi
    "$venv/bin/python" -m pip install -qq -c constraints.txt -e "$requirement"
}

# 0 and `have` where an earlier set-up of this very folder finished and its Python still runs.
have=()
read_stamp() {
    [ -f "$stamp" ] && mapfile -t have <"$stamp" && [ "${have[0]:-}" = "$repo" ] &&
        "$venv/bin/python" -I -c 'import sys, rbtm_bench; sys.exit(sys.version_info < (3, 11))' \
            2>/dev/null
}

if command -v flock >/dev/null; then # one set-up at a time
    exec 9<"$repo"
    flock 9 || true
fi

usable=false
if read_stamp; then
    usable=true
    python=$venv/bin/python
else
    python=$(find_python) || fail "Python 3.11 or newer is needed and none was found on PATH;" \
        "install it (Debian 12: apt-get install python3 python3-venv) or set PYTHON=/path/to/python"
fi

packages=$(missing_packages "$python")
if [ -n "$packages" ]; then
    mapfile -t packages <<<"$packages"
    install_packages "${packages[@]}"
fi

# The page's tests look at it with a browser. Without one they are skipped, so nothing else waits.
if [ "$kind" = dev ] && ! command -v chromium chromium-browser google-chrome >/dev/null; then
    (install_packages chromium) || say "no chromium: the tests of the page will be skipped"
fi

if $usable && [ "${have[1]:-}" = "$hash" ] && { [ "$kind" = run ] || [ "${have[2]:-}" = dev ]; }; then
    exit 0
fi

# A set-up that was cut short leaves no stamp, and what it left is not to be trusted.
if $usable; then
    [ "${have[2]:-}" = run ] || requirement=$testing # once made for testing, it stays so
    rm -f -- "$stamp"
else
    [ ! -e "$venv" ] && [ ! -L "$venv" ] || say "rebuilding .venv"
    rm -rf -- "$venv"
    "$python" -m venv "$venv"
fi
[ "$requirement" = "$running" ] || kind=dev
say "installing Python packages into .venv (up to 1.9 GB; a minute or so)"
install_python_packages || fail "installing the Python packages failed (the words are above)"
"$venv/bin/python" -I -c 'import kiss_icp, open3d, rbtm_bench' ||
    fail "the packages are installed but cannot be imported (the words are above)"
printf '%s\n' "$repo" "$hash" "$kind" >"$stamp.new"
mv -- "$stamp.new" "$stamp"
say "done"
