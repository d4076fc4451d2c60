#!/bin/sh
# Runs every check, even after one has failed, and fails if any of them did.
bin=.venv/bin
status=0
$bin/ruff check . || status=1
$bin/ruff format --check . || status=1
$bin/mypy -p tactune.core -p tactune.widgets -p tactune.app || status=1
$bin/lint-imports || status=1
if grep -rnE --include='*.py' '# noqa(: [A-Z0-9, ]+)?$' app core widgets scripts tests; then
    echo "each noqa above needs its reason: # noqa: RULE  # why" >&2
    status=1
fi
scripts/audit.sh || [ $? = 3 ] || status=1  # without a network the other checks still count
exit $status
