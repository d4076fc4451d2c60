#!/bin/sh
# Finds a Python and lets scripts/setup.py do the work. PYTHON=/path/to/python3.11 chooses another one.
set -eu
cd "$(dirname "$0")/.."

is() { command -v "$1" >/dev/null 2>&1 && "$1" -c "import sys; sys.exit(not ($2))" >/dev/null 2>&1; }

for wanted in 'sys.version_info[:2] == (3, 11)' '(3, 11) <= sys.version_info < (3, 13)'; do
    for python in "${PYTHON:-}" python3.11 python3 python3.12 .venv/bin/python; do
        if [ -n "$python" ] && is "$python" "$wanted"; then
            exec "$python" scripts/setup.py "$@"
        fi
    done
done
echo "Tactune needs Python 3.11 and found none: install it (sudo apt-get install python3.11) or name one: make PYTHON=/path/to/python3.11" >&2
exit 1
