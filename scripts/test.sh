#!/bin/sh
# The OpenGL tests need a display and Qt allows one platform per process: they run first, under Xvfb. Everything
# else runs offscreen and last, so that the closing line of the large suite is the last line printed.
set -eu
pytest="env -u WAYLAND_DISPLAY .venv/bin/python -m pytest"

if command -v xvfb-run >/dev/null 2>&1; then
    xvfb="xvfb-run --auto-servernum --server-args='-screen 0 1600x1000x24'"
elif [ -n "${DISPLAY:-}" ]; then
    xvfb=
else
    echo "The OpenGL tests need xvfb-run or a display: install xvfb with your package manager." >&2
    exit 1
fi
gl=0
eval "QT_QPA_PLATFORM=xcb $xvfb $pytest -m gl" || gl=$?
QT_QPA_PLATFORM=offscreen $pytest -m "not gl" || exit
exit $gl
