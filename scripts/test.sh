#!/usr/bin/env bash
# Runs the tests in three processes (many tests wait); `scripts/test.sh long` runs the soaks and the long random tests.
# The OpenGL tests need a display, and Qt allows one platform per process: they run first, under Xvfb.
# The last line is the sum of all runs: "N passed, N failed, N skipped".
set -uo pipefail
unset PYTHONDONTWRITEBYTECODE  # tests start hundreds of processes, and pytest rewrites each test file in each of its own
export OPENBLAS_NUM_THREADS=1  # its threads wait by spinning, and the processes share the cores
logs=$(mktemp -d)
trap 'rm -rf "$logs"' EXIT
status=0

run_pytest() { # platform, launcher, pytest's options ...
    local platform=$1 launcher=$2
    shift 2
    eval "env -u WAYLAND_DISPLAY QT_QPA_PLATFORM=$platform $launcher" .venv/bin/python -m pytest '"$@"' 2>&1 |
        tee "$logs/$(date +%s%N)" || status=1
}

gl=tests/widgets  # where all OpenGL tests are: the others need not be imported for this run
# What is compiled or solved once, and kept on the disk, is not done by several processes at the same time.
.venv/bin/python tests/support/prepare.py &
prepare=$!
if [ "${1:-}" = long ]; then
    wait $prepare || status=1
    soak=tests/core/sources/capture/test_soak.py
    run_pytest offscreen "" -m "long and not gl" --numprocesses 2 --dist worksteal --ignore $soak
    run_pytest offscreen "" $soak  # alone: beside other tests the slope of its memory is uncertain
else
    if command -v xvfb-run >/dev/null 2>&1; then
        run_pytest xcb "xvfb-run --auto-servernum --server-args='-screen 0 1600x1000x24'" -m gl $gl
    elif [ -n "${DISPLAY:-}" ]; then
        run_pytest xcb "" -m gl $gl
    else
        echo "The OpenGL tests need xvfb-run or a display: install xvfb with your package manager." >&2
        exit 1
    fi
    wait $prepare || status=1
    run_pytest offscreen "" -m "not gl and not long" --numprocesses 3 --dist worksteal
fi
scripts/sum_tests.sh "$logs"/*
exit $status
