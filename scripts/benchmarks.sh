#!/usr/bin/env bash
# Renews docs/benchmarks.md: `report` its tables and figures, `long` its section "Long runs" (35 minutes); without
# a word both. Times are worth something on an idle machine only. Exit status 1 where a requirement or a run falls short.
set -uo pipefail
cd "$(dirname "$0")/.."
page=docs/benchmarks.md
long=$(sed -n '/^## Long runs/,$p' "$page")
status=0

load() { cut -d' ' -f1-3 /proc/loadavg; }

long_runs() { # prints the section
    echo "## Long runs"
    echo
    echo "Written by \`scripts/benchmarks.sh long\`, $(date -u +%F), $(.venv/bin/python --version). The load of the machine"
    echo "(1, 5 and 15 minutes) says what else ran: losses and growth of memory count on any machine, times on an idle one."
    for command in "soak.py --minutes 30" "measure_recording.py"; do
        printf '\n```\n$ scripts/%s\nload before         %s\n' "$command" "$(load)"
        # shellcheck disable=SC2086  # a command and its options
        QT_QPA_PLATFORM=offscreen .venv/bin/python scripts/$command 2>&1 || status=1
        printf 'load after          %s\n```\n' "$(load)"
    done
    return $status
}

if [ "${1:-report}" = report ]; then
    .venv/bin/tactune bench --report "$page" || exit
    grep '^SHORT' "$page" && status=1
fi
if [ "${1:-long}" = long ]; then
    long=$(long_runs) || status=1
fi
rest=$(sed '/^## Long runs/,$d' "$page")
printf '%s\n\n%s\n' "$rest" "$long" >"$page"
exit $status
