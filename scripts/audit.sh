#!/bin/sh
# Looks up the locked packages in the index's list of known vulnerabilities. Exit status 1: there are some; 3: the index
# does not answer, so nothing could be checked.
audit="timeout 300 .venv/bin/uv tool run pip-audit>=2.9,<3 --disable-pip --no-deps --progress-spinner off"
one=$(mktemp)
trap 'rm -f "$one"' EXIT
sed -n 's/^\(numpy==[^ ]*\).*/\1/p' requirements.lock >"$one"
answer=$($audit --requirement "$one" 2>&1)
if echo "$answer" | grep -q "could not be audited" || ! echo "$answer" | grep -qi "known vulnerabilit"; then
    echo "Known vulnerabilities could not be checked: no index of vulnerabilities answers here." >&2
    exit 3
fi
$audit --require-hashes --requirement requirements.lock || exit 1
