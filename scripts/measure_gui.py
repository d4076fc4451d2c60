"""Measure the real window on a source: frames shown, heartbeat of the GUI thread, time of each step, processor time.

Processor time hardly depends on other load; times by the clock do.

Run it on an idle machine::

    QT_QPA_PLATFORM=offscreen python scripts/measure_gui.py --seconds 15
"""

from __future__ import annotations

import argparse
import os
import platform
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
from PyQt6.QtCore import QEvent, QObject, Qt, QTimer
from PyQt6.QtWidgets import QWidget

from tactune.app.cli.common import default_preset
from tactune.app.gui import make_application, start_with
from tactune.app.settings import Settings
from tactune.app.window.main_window import MainWindow
from tactune.app.worker.results import Rendered, Result
from tactune.core.contact.pipeline import ContactPatch
from tactune.core.model.patch import AlignedDepth
from tactune.widgets.basics.theme import ThemeChoice

HEARTBEAT_MS = 5
WARM_UP_FRAMES = 30
NOTHING = AlignedDepth.empty((0, 0))


class Meter(QObject):
    """Collects times and counts in a window after its warm-up frames."""

    def __init__(self, window: MainWindow, seconds: float) -> None:
        super().__init__(window)
        self._window = window
        self._seconds = seconds
        self.results: list[tuple[float, Result]] = []
        self.gaps_ms: list[float] = []
        self._left = WARM_UP_FRAMES
        self.paints = 0
        self._started_s = 0.0
        self._cpu_s = self._reading_s = 0.0
        self._beat_s = 0.0
        self._heart = QTimer(self)
        self._heart.setTimerType(Qt.TimerType.PreciseTimer)
        self._heart.setInterval(HEARTBEAT_MS)
        self._heart.timeout.connect(self._beat)
        window.context.frameShown.connect(self._frame_shown)
        canvas = window.views.views["patch"].findChild(QWidget, "canvas")
        if canvas is not None:
            canvas.installEventFilter(self)

    def eventFilter(self, watched: QObject | None, event: QEvent | None) -> bool:
        """Count the paint events of the patch view."""
        if self._started_s and event is not None and event.type() == QEvent.Type.Paint:
            self.paints += 1
        return False

    def _frame_shown(self) -> None:
        result = self._window.result
        if result is None or (result.patch is None and not self.results):  # kernels are being compiled
            return
        self._left -= 1
        if self._left >= 0:
            return
        now = time.perf_counter()
        if not self._started_s:
            self._started_s = now
            self._cpu_s, self._reading_s = -time.process_time(), -_reading_s()
            self._beat_s = now
            self._heart.start()
        self.results.append((now, _light(result)))
        if now - self._started_s >= self._seconds:
            self._window.context.frameShown.disconnect(self._frame_shown)
            self._heart.stop()
            self._cpu_s += time.process_time()
            self._reading_s += _reading_s()
            self._window.close()

    def _beat(self) -> None:
        now = time.perf_counter()
        self.gaps_ms.append(1e3 * (now - self._beat_s))
        self._beat_s = now

    def report(self) -> str:
        """Return all numbers as text."""
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
        series = self._window.timeline.series
        share = 100 * series.computed.mean() if series is not None else 0
        points = [len(result.patch.points) for _, result in self.results if result.patch is not None]
        shown = len(self.results) - 1
        size = self._window.size()
        lines = [
            f"window            {size.width()} x {size.height()}",
            f"frames shown      {shown / seconds:.1f} per second",
            f"patch painted     {self.paints / seconds:.1f} per second",
            f"frames processed  {processed / seconds:.1f} per second",
            f"frames dropped    {last[1].dropped - first[1].dropped}",
            f"time strip        {share:.0f} % of the frames computed",
            f"points            median {np.median(points):.0f}, most {max(points)}",
            f"heartbeat gap     {_spread(self.gaps_ms)} ms ({HEARTBEAT_MS} ms timer)",
            f"processor         {1e3 * self._cpu_s / shown:.2f} ms per frame shown, all threads; "
            f"{1e3 * self._reading_s / shown:.2f} ms of them on the thread that reads (decodes, adds noise)",
            "milliseconds per frame, by the clock:",
            *(f"  {stage:<22}{_spread(values)}" for stage, values in stages.items()),
        ]
        return "\n".join(lines)


def _reading_s() -> float:
    """Return the processor time of the thread that reads frames, seconds."""
    readers = (thread for thread in threading.enumerate() if thread.name.startswith("reader"))
    return sum(time.clock_gettime(time.pthread_getcpuclockid(thread.ident)) for thread in readers if thread.ident)


def _light(result: Result) -> Result:
    """Return a result without its images: kept ones would make all code write to fresh memory."""
    patch = result.patch
    if patch is not None:
        patch = ContactPatch(0, patch.points, np.empty((0, 0), np.uint8), NOTHING, patch.rig, patch.stage_ms)
    return replace(result, frame=None, rendered=Rendered(), compared=None, patch=patch)  # type: ignore[arg-type]


def _spread(values: Iterable[float]) -> str:
    half, most, highest = np.percentile(list(values), (50, 95, 100))
    return f"p50 {half:5.1f}   p95 {most:5.1f}   max {highest:5.1f}"


def main() -> int:
    """Run the window and print the measurements."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", default="sim:cup?sensor=datasheet")
    parser.add_argument("--preset", default=None, help="a file or a shipped name; default: as the window chooses")
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--size", default="1280x800")
    parser.add_argument("--theme", choices=("light", "dark"), default="light")
    parser.add_argument("--no-strip", action="store_true", help="hide the time strip; nothing is computed for it")
    options = parser.parse_args()
    preset, _ = start_with(options.preset or default_preset(options.source))
    application = make_application()
    with tempfile.TemporaryDirectory(prefix="tactune-") as folder:
        settings = Settings(Path(folder) / "window.json")
        settings.set("window/hidden", "show_time" if options.no_strip else "")
        window = MainWindow(preset, settings, Path(folder))
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
