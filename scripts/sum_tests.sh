#!/bin/sh
# Adds up the closing lines of the pytest runs in the given logs: "N passed, N failed, N skipped"; errors are failures.
grep -hE '^=+ .+ in [0-9.]+s.* =+$' "$@" | tr ',=' '\n\n' | awk '
    $2 == "passed" { passed += $1 }
    $2 == "failed" || $2 ~ /^errors?$/ { failed += $1 }
    $2 == "skipped" { skipped += $1 }
    END { printf "%d passed, %d failed, %d skipped\n", passed, failed, skipped }'
