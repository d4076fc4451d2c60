"""Measure the real window on a source: frames shown, heartbeat of the GUI thread, time per stage.

Run it alone on the machine; nothing in it is a test. For example::

    QT_QPA_PLATFORM=offscreen python scripts/measure_gui.py --seconds 15
    xvfb-run -a -s "-screen 0 1920x1080x24" python scripts/measure_gui.py --theme dark
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import cast

import numpy as np
from PyQt6.QtCore import QEvent, QObject, Qt, QTimer
from PyQt6.QtWidgets import QWidget

from tactune.app.gui import make_application, start_with
from tactune.app.settings import Settings
from tactune.app.window.main_window import MainWindow
from tactune.app.worker.results import Result
from tactune.widgets.basics.theme import ThemeChoice

HEARTBEAT_MS = 5
WARM_UP_FRAMES = 30


class Meter(QObject):
    """Collects what happens in a window from its first warm frame on."""

    def __init__(self, window: MainWindow, seconds: float) -> None:
        super().__init__(window)
        self._window = window
        self._seconds = seconds
        self.results: list[tuple[float, Result]] = []
        self.gaps_ms: list[float] = []
        self.paints = 0
        self.painted_s: list[float] = []
        self._last_beat_s = 0.0
        self._started_s = 0.0
        self._cpu_s = 0.0
        self._heart = QTimer(self)
        self._heart.setTimerType(Qt.TimerType.PreciseTimer)
        self._heart.setInterval(HEARTBEAT_MS)
        self._heart.timeout.connect(self._beat)
        window.frameShown.connect(self._frame_shown)
        canvas = window.views.views["patch"].findChild(QWidget, "canvas")
        if canvas is not None:
            canvas.installEventFilter(self)

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Count how often the patch is really painted."""
        if self._started_s and event is not None and event.type() == QEvent.Type.Paint:
            self.paints += 1
        return False

    def _frame_shown(self) -> None:
        result = self._window.result
        if result is None or result.processed < WARM_UP_FRAMES:
            return
        now = time.perf_counter()
        if not self._started_s:
            self._started_s = self._last_beat_s = now
            self._cpu_s = -time.process_time()
            self._heart.start()
        self.results.append((now, result))
        if now - self._started_s >= self._seconds:
            self._window.frameShown.disconnect(self._frame_shown)
            self._heart.stop()
            self._cpu_s += time.process_time()
            self._window.close()

    def _beat(self) -> None:
        now = time.perf_counter()
        self.gaps_ms.append(1e3 * (now - self._last_beat_s))
        self._last_beat_s = now

    def report(self) -> str:
        """Write all numbers in words."""
        first, last = self.results[0], self.results[-1]
        seconds = last[0] - first[0]
        processed = last[1].processed - first[1].processed
        stages: dict[str, list[float]] = defaultdict(list)
        for _, result in self.results:
            stages["read"].append(result.read_ms)
            stages["draw for the window"].append(result.render_ms)
            if result.patch is not None:
                for stage, ms in result.patch.stage_ms.items():
                    stages[stage].append(ms)
        points = [len(result.patch.points) for _, result in self.results if result.patch is not None]
        size = self._window.size()
        view = self._window.views.views["patch"]
        lines = [
            f"window            {size.width()} x {size.height()}, {view.backend_name} views {view.backend_reason}",
            f"frames shown      {(len(self.results) - 1) / seconds:.1f} per second",
            f"patch painted     {self.paints / seconds:.1f} per second",
            f"frames processed  {processed / seconds:.1f} per second",
            f"frames dropped    {last[1].dropped - first[1].dropped}",
            f"processor time    {1e3 * self._cpu_s / processed:.1f} ms per frame, all threads",
            f"points            median {np.median(points):.0f}, most {max(points)}",
            f"heartbeat gap     {_spread(self.gaps_ms)} ms ({HEARTBEAT_MS} ms timer)",
            "milliseconds per frame:",
            *(f"  {stage:<22}{_spread(values)}" for stage, values in stages.items()),
        ]
        return "\n".join(lines)


def _spread(values: Iterable[float]) -> str:
    half, most, highest = np.percentile(list(values), (50, 95, 100))
    return f"p50 {half:5.1f}   p95 {most:5.1f}   max {highest:5.1f}"


def main() -> int:
    """Run the window for a while and print what was measured."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", default="sim")
    parser.add_argument("--preset", default=None, help="a file or a shipped name; default: as the window chooses")
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--size", default="1280x800")
    parser.add_argument("--theme", choices=("light", "dark"), default="light")
    parser.add_argument("--backend", choices=("auto", "opengl", "software"), default="auto")
    options = parser.parse_args()
    preset, _ = start_with(options.preset, options.source)
    application = make_application()
    with tempfile.TemporaryDirectory(prefix="tactune-") as folder:
        window = MainWindow(preset, Settings(Path(folder) / "window.ini"), Path(folder), backend=options.backend)
        window.set_theme(cast(ThemeChoice, options.theme), remember=False)
        width, height = (int(part) for part in options.size.split("x"))
        window.resize(width, height)
        window.error_hook.install()
        meter = Meter(window, options.seconds)
        window.show()
        window.open_source(options.source)
        application.exec()
    sys.stdout.write(
        f"machine           {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, Python {platform.python_version()}, "
        f"{application.platformName()}\n{meter.report()}\n"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
