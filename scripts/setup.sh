#!/bin/sh
# Finds a Python and lets scripts/setup.py do the work. PYTHON=/path/to/python chooses another one.
set -eu
cd "$(dirname "$0")/.."

is() { command -v "$1" >/dev/null 2>&1 && "$1" -c "import sys; sys.exit(not ($2))" >/dev/null 2>&1; }

if [ -n "${PYTHON:-}" ]; then
    if is "$PYTHON" 'sys.version_info >= (3, 11)'; then
        exec "$PYTHON" scripts/setup.py "$@"
    fi
    echo "PYTHON=$PYTHON cannot be run, or is older than Python 3.11: name another one, or leave PYTHON out." >&2
    exit 1
fi

for wanted in 'sys.version_info[:2] == (3, 11)' '(3, 11) <= sys.version_info < (3, 14)'; do
    for python in python3.11 python3 python3.12 python3.13 .venv/bin/python; do
        if is "$python" "$wanted"; then
            exec "$python" scripts/setup.py "$@"
        fi
    done
done
echo "Tactune needs Python 3.11 and found none: sudo apt-get install python3.11, or make PYTHON=/path/to/python3.11" >&2
exit 1
