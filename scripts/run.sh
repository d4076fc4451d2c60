#!/bin/sh
# Starts the window on a source with a preset, or, where they are empty, on those of the last time, at first the
# simulator. Without a display, the work runs headless on the simulator and writes to a folder.
set -eu
source=$1 preset=$2 out=$3
tactune=.venv/bin/tactune

can_open_a_window() {
    [ -n "${DISPLAY:-}${WAYLAND_DISPLAY:-}" ] &&
        .venv/bin/python -c 'from PyQt6.QtGui import QGuiApplication; QGuiApplication([])' >/dev/null 2>&1
}

if can_open_a_window; then
    exec "$tactune" gui ${source:+--source "$source"} ${preset:+--preset "$preset"}
fi

if [ -n "${DISPLAY:-}${WAYLAND_DISPLAY:-}" ]; then
    echo "The display ${DISPLAY:-$WAYLAND_DISPLAY} cannot be opened; doing the same job without it."
else
    echo "There is no display; doing the same job without it."
fi
source=${source:-sim}
"$tactune" run --source "$source" ${preset:+--preset "$preset"} --frames 90 --out "$out/patches"
set -- gui --source "$source" ${preset:+--preset "$preset"} --screenshot "$out/window.png"
QT_QPA_PLATFORM=offscreen "$tactune" "$@"
echo "Patches are in $out/patches, the window is in $out/window.png; to see it live, run make run on a machine with a screen or over ssh -X."
