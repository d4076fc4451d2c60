#!/bin/sh
# Starts the window on a source with a preset. Without a display, the same work runs headless and writes to a folder.
set -eu
source=$1 preset=$2 out=$3
tactune=.venv/bin/tactune

can_open_a_window() {
    [ -n "${DISPLAY:-}${WAYLAND_DISPLAY:-}" ] &&
        .venv/bin/python -c 'from PyQt6.QtGui import QGuiApplication; QGuiApplication([])' >/dev/null 2>&1
}

if can_open_a_window; then
    exec "$tactune" gui --source "$source" --preset "$preset"
fi

if [ -n "${DISPLAY:-}${WAYLAND_DISPLAY:-}" ]; then
    echo "The display ${DISPLAY:-$WAYLAND_DISPLAY} cannot be opened; doing the same job without it."
else
    echo "There is no display; doing the same job without it."
fi
"$tactune" run --source "$source" --preset "$preset" --frames 90 --out "$out/patches"
set -- gui --source "$source" --preset "$preset" --screenshot "$out/window.png"
QT_QPA_PLATFORM=offscreen "$tactune" "$@"
echo "Patches are in $out/patches, the window is in $out/window.png; to see it live, run make run on a machine with a screen or over ssh -X."
