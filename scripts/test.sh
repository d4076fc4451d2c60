#!/usr/bin/env bash
# Runs the tests in three processes (many tests wait); `scripts/test.sh long` runs the soaks and the long random tests.
# The last line is the sum of all runs: "N passed, N failed, N skipped".
set -uo pipefail
unset PYTHONDONTWRITEBYTECODE  # tests start hundreds of processes, and pytest rewrites each test file in each of its own
export OPENBLAS_NUM_THREADS=1  # its threads wait by spinning, and the processes share the cores
export QT_QPA_PLATFORM=offscreen
logs=$(mktemp -d)
trap 'rm -rf "$logs"' EXIT
status=0

run_pytest() { # pytest's options ...
    .venv/bin/python -m pytest "$@" 2>&1 | tee "$logs/$(date +%s%N)" || status=1
}

# What is compiled or solved once, and kept on the disk, is not done by several processes at the same time.
.venv/bin/python tests/support/prepare.py || status=1
if [ "${1:-}" = long ]; then
    soak=tests/core/sources/capture/test_soak.py
    run_pytest -m long --numprocesses 2 --dist worksteal --ignore $soak
    run_pytest $soak  # alone: beside other tests the slope of its memory is uncertain
else
    run_pytest -m "not long" --numprocesses 3 --dist worksteal
fi
scripts/sum_tests.sh "$logs"/*
exit $status
