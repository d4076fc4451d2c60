"""Measure the real window on a source: frames shown, heartbeat of the GUI thread, time of each step, processor time.

Processor time hardly depends on other load; times by the clock do. Run it on an idle machine::

    QT_QPA_PLATFORM=offscreen python scripts/measure_gui.py --seconds 15
"""

from __future__ import annotations

import argparse
import os
import platform
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import cast

import numpy as np
from PyQt6.QtCore import QObject, Qt

from tactune.app.gui import make_application
from tactune.app.settings import Settings
from tactune.app.window.main_window import MainWindow
from tactune.app.worker.reading import FrameReader
from tactune.core.sources.presets import default_preset, load_preset
from tactune.widgets.basics.controls import timer
from tactune.widgets.basics.theme import ThemeChoice

HEARTBEAT_MS = 10
#: A round of the default recording, in which the simulator unpacks its scene.
WARM_UP_FRAMES = 90
_read = FrameReader._read


class Meter(QObject):
    """Collects times and counts in a window after its warm-up frames, then closes it."""

    def __init__(self, window: MainWindow, seconds: float) -> None:
        super().__init__(window)
        self._window, self._seconds = window, seconds
        self._left = WARM_UP_FRAMES
        self._started_s, self._cpu_s, self._beat_s = 0.0, 0.0, 0.0
        self._source_s = 0.0  # processor time of reading frames, which a simulator computes
        self._counts: list[tuple[int, int]] = []  # frames processed and dropped so far
        self.points: list[int] = []
        self.stages: dict[str, list[float]] = defaultdict(list)
        self.gaps_ms: list[float] = []
        self._heart = timer(self, HEARTBEAT_MS, self._beat)
        self._heart.setTimerType(Qt.TimerType.PreciseTimer)
        window.context.frameShown.connect(self._frame_shown)

    def read(self, reader: FrameReader, index: int) -> object:
        """Read a frame as the reader does, and count the processor time."""
        started = time.thread_time()
        try:
            return _read(reader, index)
        finally:
            if self._counts:
                self._source_s += time.thread_time() - started

    def _frame_shown(self) -> None:
        result = self._window.result
        if result is None or (result.patch is None and not self._counts):  # kernels are being compiled
            return
        self._left -= 1
        if self._left >= 0:
            return
        now = time.perf_counter()
        if not self._counts:
            self._started_s = self._beat_s = now
            self._cpu_s = -time.process_time()
            self._heart.start()
        self._counts.append((result.processed, result.dropped))
        self.stages["read"].append(result.read_ms)
        self.stages["draw for the window"].append(result.render_ms)
        if result.patch is not None:
            self.points.append(len(result.patch.points))
            for stage, ms in result.patch.stage_ms.items():
                self.stages[stage].append(ms)
        if now - self._started_s >= self._seconds:
            self._window.context.frameShown.disconnect(self._frame_shown)
            self._heart.stop()
            self._cpu_s += time.process_time()
            self._seconds = now - self._started_s
            self._window.close()

    def _beat(self) -> None:
        now = time.perf_counter()
        self.gaps_ms.append(1e3 * (now - self._beat_s))
        self._beat_s = now

    def report(self) -> str:
        """Return all numbers as text."""
        (processed, dropped), (all_processed, all_dropped) = self._counts[0], self._counts[-1]
        shown, size = len(self._counts) - 1, self._window.size()
        lines = [
            f"window            {size.width()} x {size.height()}",
            f"frames shown      {shown / self._seconds:.1f} per second",
            f"frames processed  {(all_processed - processed) / self._seconds:.1f} per second",
            f"frames dropped    {all_dropped - dropped}",
            f"points            median {np.median(self.points):.0f}, most {max(self.points)}",
            f"heartbeat gap     {_spread(self.gaps_ms)} ms ({HEARTBEAT_MS} ms timer)",
            f"processor         {1e3 * self._cpu_s / shown:.2f} ms per frame shown, all threads",
            f"of these, source  {1e3 * self._source_s / shown:.2f} ms, in which the simulator computes its frames",
            "milliseconds per frame, by the clock:",
            *(f"  {stage:<22}{_spread(values)}" for stage, values in self.stages.items()),
        ]
        return "\n".join(lines)


def _spread(values: Iterable[float]) -> str:
    half, most, highest = np.percentile(list(values), (50, 95, 100))
    return f"p50 {half:5.1f}   p95 {most:5.1f}   max {highest:5.1f}"


def main() -> None:
    """Run the window and print the measurements."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--source", default="sim:cup?sensor=datasheet")
    parser.add_argument("--preset", default=None, help="a file or a shipped name; default: as the window chooses")
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--size", default="1280x800")
    parser.add_argument("--theme", choices=("light", "dark"), default="light")
    options = parser.parse_args()
    preset = load_preset(options.preset or default_preset(options.source))
    application = make_application()
    with tempfile.TemporaryDirectory(prefix="tactune-") as folder:
        window = MainWindow(preset, Settings(Path(folder) / "window.json"), Path(folder))
        window.set_theme(cast(ThemeChoice, options.theme), remember=False)
        window.resize(*(int(part) for part in options.size.split("x")))
        window.error_hook.install()
        meter = Meter(window, options.seconds)
        FrameReader._read = lambda reader, index: meter.read(reader, index)  # type: ignore[method-assign]  # noqa: PLW0108  # a bound method would lose the reader
        window.show()
        window.open_source(options.source)
        application.exec()
    load = f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}"
    print(f"machine           {load}, Python {platform.python_version()}, {application.platformName()}")
    print(meter.report())


if __name__ == "__main__":
    main()
