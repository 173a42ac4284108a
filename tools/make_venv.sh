#!/bin/sh
# Makes .venv with the pinned versions and installs the project into it, editable.
set -eu
python=${PYTHON:-python3}
command -v "$python" >/dev/null 2>&1 || { echo "error: $python not found: install Python 3.11 or newer" >&2; exit 2; }
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
    { echo "error: $("$python" --version 2>&1) is too old: Python 3.11 or newer is needed; set PYTHON=..." >&2; exit 2; }

make_venv() {
    "$python" -m venv --clear .venv >/dev/null 2>&1 && return
    # Debian and Ubuntu keep ensurepip in a package of its own.
    "$python" -m virtualenv -q --clear .venv >/dev/null 2>&1 && return
    if command -v apt-get >/dev/null 2>&1 && [ "$(id -u)" = 0 ]; then
        echo "installing the system package python3-venv (this Python cannot make virtual environments by itself)"
        if apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq python3-venv >/dev/null &&
            "$python" -m venv --clear .venv; then
            return
        fi
    fi
    rm -rf .venv
    echo "error: $python cannot make a virtual environment: run 'sudo apt-get install python3-venv' and try again" >&2
    exit 2
}

.venv/bin/pip --version >/dev/null 2>&1 || { echo "making .venv"; make_venv; }
echo "installing pinned packages into .venv (about 1.5 GB on disk, a minute or two the first time)"
.venv/bin/pip install -q --disable-pip-version-check -c constraints.txt -e '.[dev]'
# MAVProxy only serves as a ground station in the tests; its map windows would bring 800 MB of vtk and OpenCV.
.venv/bin/pip install -q --disable-pip-version-check -c constraints.txt --no-deps MAVProxy
