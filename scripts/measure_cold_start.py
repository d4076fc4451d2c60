"""Measure a cold start: processor and wall time from the start of a process to its first frames, nothing compiled.

Each row is a fresh process with an empty cache of kernels and an empty folder for solved scenes. Processor time is that
of the whole process until then, drawing of the frames that are shown meanwhile included; wall time depends on what else
the computer does. The window needs a display or ``QT_QPA_PLATFORM=offscreen``.

    .venv/bin/python scripts/measure_cold_start.py [--source sim]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

CLOCK = """
import sys, time
begun = time.perf_counter()
def at(what):
    print(f"{what}|{time.process_time():.1f}|{time.perf_counter() - begun:.1f}", flush=True)
"""

WINDOW = """
from tactune.app import gui
from tactune.app.window.main_window import MainWindow

show, told = MainWindow.show, set()
def watched(window):
    def once(what):
        if what not in told:
            told.add(what)
            at(what)
    def shown():
        once("window: first clouds")
        if window.result.patch is not None:
            once("window: first patch")
            window.close()
    window.context.frameShown.connect(shown)
    show(window)
    once("window: open")
MainWindow.show = watched
gui.run_gui(sys.argv[1], "simulator", None, 1)
"""

RUN = """
from tactune.app.cli import run
process = run.process_frames
def first(source, step, *rest, **options):
    def timed(frame):
        done = step(frame)
        at("tactune run: first patch")
        return done
    return process(source, timed, *rest, **options)
run.process_frames = first
run.run(source=sys.argv[1], preset="simulator", frames=1, json_lines=True)
"""

ALL = """
from tactune.core.warmup import warm_up
warm_up()
at("all contact tests compiled")
"""


def main() -> None:
    """Print one line for each event."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("--source", default="sim", help="Source of frames (default: sim).")
    source = options.parse_args().source
    print(f"{'event':<28}{'processor s':>12}{'wall s':>8}")
    for program in (WINDOW, RUN, ALL):
        with tempfile.TemporaryDirectory() as folder:
            homes = dict.fromkeys(("XDG_CACHE_HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME"), folder)
            environment = os.environ | homes | {"NUMBA_CACHE_DIR": str(Path(folder) / "kernels")}
            command = [sys.executable, "-c", CLOCK + program, source]
            done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
        for line in done.stdout.splitlines():
            if line.count("|") == 2:
                event, processor_s, wall_s = line.split("|")
                print(f"{event:<28}{processor_s:>12}{wall_s:>8}", flush=True)


if __name__ == "__main__":
    main()
