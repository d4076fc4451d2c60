"""Measure what an open Compare tab costs the main window: heartbeat and frames shown, with and without it.

Both alternate every few seconds in one window, so that whatever else the machine does weighs on both. For example::

    QT_QPA_PLATFORM=offscreen python scripts/measure_compare.py --rounds 6
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from PyQt6.QtCore import QObject, Qt, QTimer

from tactune.app.analysis.compare_tab import CompareTab
from tactune.app.gui import make_application, start_with
from tactune.app.settings import Settings
from tactune.app.window.main_window import MainWindow
from tactune.core.methods.registry import method_names

HEARTBEAT_MS = 5


class Rounds(QObject):
    """Shows and hides the analysis window in turn, and counts in both states."""

    def __init__(self, window: MainWindow, rounds: int, seconds: float) -> None:
        super().__init__(window)
        self._window, self._left, self._seconds = window, 2 * rounds, seconds
        self._comparing = False
        self.gaps_ms: dict[bool, list[float]] = {False: [], True: []}
        self.frames = {False: 0, True: 0}
        self.comparisons = 0
        window.actions_.compare.trigger()
        analysis = window.analysis.launcher.window
        assert analysis is not None
        self._analysis = analysis
        tab = analysis.made["compare"]
        assert isinstance(tab, CompareTab)
        self._tab = tab
        self._last_s = time.perf_counter()
        self._heart = QTimer(self)
        self._heart.setTimerType(Qt.TimerType.PreciseTimer)
        self._heart.setInterval(HEARTBEAT_MS)
        self._heart.timeout.connect(self._beat)
        self._turns = QTimer(self)
        self._turns.setInterval(round(1e3 * seconds))
        self._turns.timeout.connect(self._turn)
        self._ready = QTimer(self)
        self._ready.setInterval(100)
        self._ready.timeout.connect(self._begin_when_ready)
        self._ready.start()

    def _begin_when_ready(self) -> None:
        comparison = self._tab.comparison
        if comparison is None or self._tab.untouched.searching or comparison.task.no_untouched:
            return
        self._ready.stop()
        self._window.frameShown.connect(self._frame_shown)
        self._tab.shown.connect(self._compared)
        self._analysis.hide()
        self._last_s = time.perf_counter()
        self._heart.start()
        self._turns.start()

    def _turn(self) -> None:
        self._left -= 1
        if self._left == 0:
            self._heart.stop()
            self._turns.stop()
            self._window.close()
            return
        self._comparing = not self._comparing
        self._analysis.setVisible(self._comparing)
        self._last_s = time.perf_counter()

    def _beat(self) -> None:
        now = time.perf_counter()
        self.gaps_ms[self._comparing].append(1e3 * (now - self._last_s))
        self._last_s = now

    def _frame_shown(self) -> None:
        self.frames[self._comparing] += 1

    def _compared(self) -> None:
        self.comparisons += 1

    def report(self, rounds: int) -> str:
        """Write all numbers in words."""
        alone, beside = (np.percentile(self.gaps_ms[state], (50, 95, 100)) for state in (False, True))
        seconds = rounds * self._seconds
        lines = [f"{'':<22}{'without':>9}{'with':>9}{'ratio':>8}"]
        shown = [self.frames[state] / seconds for state in (False, True)]
        rows = [("frames shown a second", *shown)]
        rows += [
            (f"heartbeat {name}, ms", *pair) for name, *pair in zip(("p50", "p95", "max"), alone, beside, strict=True)
        ]
        lines += [f"{name:<22}{first:9.1f}{second:9.1f}{second / first:8.2f}" for name, first, second in rows]
        return "\n".join([*lines, f"comparisons a second  {self.comparisons / seconds:18.1f}"])


def main() -> int:
    """Alternate and print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", default="sim:cup?press=medium")
    parser.add_argument("--methods", default=",".join(method_names()))
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--seconds", type=float, default=5.0, help="of each state in a round")
    options = parser.parse_args()
    preset, _ = start_with(None, options.source)
    application = make_application()
    with tempfile.TemporaryDirectory(prefix="tactune-") as folder:
        settings = Settings(Path(folder) / "window.ini")
        settings.set("compare/methods", options.methods)
        window = MainWindow(preset, settings, Path(folder))
        window.resize(1280, 800)
        window.error_hook.install()
        window.show()
        window.open_source(options.source)
        rounds = Rounds(window, options.rounds, options.seconds)
        application.exec()
    sys.stdout.write(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}\n{rounds.report(options.rounds)}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
