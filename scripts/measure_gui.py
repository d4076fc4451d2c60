"""Measure the real window on a source: frames shown, heartbeat of the GUI thread, time and processor time per stage.

Processor time hardly depends on other load; times by the clock do.

With ``--compare N``, measure instead how much an open Compare tab slows the window down. Both states alternate N times,
so that other load affects both equally. With ``--against PRESET``, the window compares its preset with another one at
the wipe. Run it on an idle machine::

    QT_QPA_PLATFORM=offscreen python scripts/measure_gui.py --seconds 15
    QT_QPA_PLATFORM=offscreen python scripts/measure_gui.py --compare 6 --source 'sim:cup?press=medium&sensor=datasheet'
    xvfb-run -a -s "-screen 0 1920x1080x24" python scripts/measure_gui.py --theme dark
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
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyqtgraph
from PyQt6.QtCore import QEvent, QObject, Qt, QTimer
from PyQt6.QtWidgets import QWidget

from tactune.app.analysis.compare_tab import CompareTab
from tactune.app.cli.common import default_preset
from tactune.app.document.comparison import Side
from tactune.app.gui import make_application, start_with
from tactune.app.settings import Settings
from tactune.app.window.frame_presenter import FramePresenter
from tactune.app.window.main_window import MainWindow
from tactune.app.worker import processing, reading, rendering, worker
from tactune.app.worker.results import Rendered, Result
from tactune.core.contact.pipeline import ContactPatch
from tactune.core.methods.registry import method_names
from tactune.core.model.patch import AlignedDepth
from tactune.core.sources.presets import load_preset
from tactune.widgets.basics.theme import ThemeChoice
from tactune.widgets.clouds.software_backend import SoftwareCanvas, SoftwareRenderer

HEARTBEAT_MS = 5
WARM_UP_FRAMES = 30
NOTHING = AlignedDepth.empty((0, 0))


class Heart(QObject):
    """A timer on the GUI thread that reports the time between its beats, in ms."""

    def __init__(self, parent: QObject, beat: Callable[[float], None]) -> None:
        super().__init__(parent)
        self._beat = beat
        self._last_s = 0.0
        self._timer = QTimer(self)
        self._timer.setTimerType(Qt.TimerType.PreciseTimer)
        self._timer.setInterval(HEARTBEAT_MS)
        self._timer.timeout.connect(self._tick)

    def start(self) -> None:
        """Start beating, or forget the time since the last beat."""
        self._last_s = time.perf_counter()
        self._timer.start()

    def stop(self) -> None:
        """Stop beating."""
        self._timer.stop()

    def _tick(self) -> None:
        now = time.perf_counter()
        self._beat(1e3 * (now - self._last_s))
        self._last_s = now


class Stages:
    """Processor time of functions on the threads that call them, each without the stages inside it."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = defaultdict(float)
        self._local = threading.local()

    def watch(self, owner: object, name: str, stage: str) -> None:
        """Count all later calls of a function or method as this stage."""
        function = getattr(owner, name)

        def timed(*given: Any, **named: Any) -> Any:
            inside = self._local.__dict__.setdefault("inside", [])
            inside.append(0.0)
            started = time.thread_time()
            try:
                return function(*given, **named)
            finally:
                took = time.thread_time() - started
                self.seconds[stage] += took - inside.pop()
                if inside:
                    inside[-1] += took

        setattr(owner, name, timed)


def watched_stages() -> Stages:
    """Watch what a shown frame costs; to be called before the window is made."""
    stages = Stages()
    for owner, name, stage in (
        (reading.FrameReader, "_read", "read (simulate, decode)"),
        (processing.PatchFinder, "find", "patch"),
        (rendering, "draw_strip", "worker: colour the images"),
        (processing.Renderer, "render", "worker: colour the clouds"),
        (worker.Worker, "_process", "worker: other"),
        (worker.Worker, "_examine", "worker: findings"),
        (SoftwareRenderer, "render", "window: draw the clouds"),
        (SoftwareCanvas, "paintEvent", "window: paint over the clouds"),
        (pyqtgraph.GraphicsView, "paintEvent", "window: paint images, histogram"),
        (FramePresenter, "show", "window: update the widgets"),
        (MainWindow, "_show_newest", "window: tell other parts"),
    ):
        stages.watch(owner, name, stage)
    return stages


class Meter(QObject):
    """Collects times and counts in a window after its warm-up frames."""

    def __init__(self, window: MainWindow, seconds: float, stages: Stages) -> None:
        super().__init__(window)
        self._window = window
        self._seconds = seconds
        self._stages = stages
        self._stage_s: dict[str, float] = {}
        self.results: list[tuple[float, Result]] = []
        self.gaps_ms: list[float] = []
        self._left = WARM_UP_FRAMES
        self.paints = 0
        self.painted_s: list[float] = []
        self._started_s = 0.0
        self._cpu_s = 0.0
        self._heart = Heart(self, self.gaps_ms.append)
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
            self._cpu_s = -time.process_time()
            self._stages.seconds.clear()
            self._heart.start()
        self.results.append((now, _light(result)))
        if now - self._started_s >= self._seconds:
            self._window.context.frameShown.disconnect(self._frame_shown)
            self._heart.stop()
            self._cpu_s += time.process_time()
            self._stage_s = dict(self._stages.seconds)
            self._window.close()

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
        processor_s = dict(sorted(self._stage_s.items(), key=lambda item: -item[1]))
        processor_s["other (Qt, other widgets)"] = self._cpu_s - sum(processor_s.values())
        processor_s["all"] = self._cpu_s
        size = self._window.size()
        view = self._window.views.views["patch"]
        lines = [
            f"window            {size.width()} x {size.height()}, {view.backend_name} views {view.backend_reason}",
            f"frames shown      {(len(self.results) - 1) / seconds:.1f} per second",
            f"patch painted     {self.paints / seconds:.1f} per second",
            f"frames processed  {processed / seconds:.1f} per second",
            f"frames dropped    {last[1].dropped - first[1].dropped}",
            f"time strip        {share:.0f} % of the frames computed",
            f"points            median {np.median(points):.0f}, most {max(points)}",
            f"heartbeat gap     {_spread(self.gaps_ms)} ms ({HEARTBEAT_MS} ms timer)",
            "milliseconds per frame, by the clock:",
            *(f"  {stage:<22}{_spread(values)}" for stage, values in stages.items()),
            "milliseconds of processor per frame shown, all threads:",
            *(f"  {stage:<32}{1e3 * seconds / shown:6.2f}" for stage, seconds in processor_s.items()),
        ]
        return "\n".join(lines)


class Rounds(QObject):
    """Shows and hides the analysis window alternately and measures both states."""

    def __init__(self, window: MainWindow, rounds: int, seconds: float) -> None:
        super().__init__(window)
        self._window, self._rounds, self._left, self._seconds = window, rounds, 2 * rounds, seconds
        self._comparing = False
        self.gaps_ms: dict[bool, list[float]] = {False: [], True: []}
        self.frames = {False: 0, True: 0}
        self.comparisons = 0
        window.analysis.open("compare")
        analysis = window.analysis.window
        assert analysis is not None
        self._analysis = analysis
        tab = analysis.made["compare"]
        assert isinstance(tab, CompareTab)
        self._tab = tab
        self._heart = Heart(self, self._beat)
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
        self._window.context.frameShown.connect(self._frame_shown)
        self._tab.shown.connect(self._compared)
        self._analysis.hide()
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
        self._heart.start()

    def _beat(self, gap_ms: float) -> None:
        self.gaps_ms[self._comparing].append(gap_ms)

    def _frame_shown(self) -> None:
        self.frames[self._comparing] += 1

    def _compared(self) -> None:
        self.comparisons += 1

    def report(self) -> str:
        """Return all numbers as text."""
        alone, beside = (np.percentile(self.gaps_ms[state], (50, 95, 100)) for state in (False, True))
        seconds = self._rounds * self._seconds
        lines = [f"{'':<22}{'without':>9}{'with':>9}{'ratio':>8}"]
        shown = [self.frames[state] / seconds for state in (False, True)]
        rows = [("frames shown a second", *shown)]
        rows += [
            (f"heartbeat {name}, ms", *pair) for name, *pair in zip(("p50", "p95", "max"), alone, beside, strict=True)
        ]
        lines += [f"{name:<22}{first:9.1f}{second:9.1f}{second / first:8.2f}" for name, first, second in rows]
        return "\n".join([*lines, f"comparisons a second  {self.comparisons / seconds:18.1f}"])


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
    parser.add_argument("--seconds", type=float, default=15.0, help="with --compare: of each state in a round")
    parser.add_argument("--size", default="1280x800")
    parser.add_argument("--theme", choices=("light", "dark"), default="light")
    parser.add_argument("--backend", choices=("auto", "opengl", "software"), default="auto")
    parser.add_argument("--against", default=None, metavar="PRESET", help="compare with this preset at the wipe")
    parser.add_argument("--compare", type=int, default=0, metavar="ROUNDS", help="measure the cost of the Compare tab")
    parser.add_argument("--methods", default=",".join(method_names()), help="the methods that are compared")
    parser.add_argument("--no-strip", action="store_true", help="hide the time strip; nothing is computed for it")
    options = parser.parse_args()
    preset, _ = start_with(options.preset or default_preset(options.source))
    application = make_application()
    with tempfile.TemporaryDirectory(prefix="tactune-") as folder:
        settings = Settings(Path(folder) / "window.json")
        settings.set("compare/methods", options.methods)
        settings.set("window/hidden", "show_time" if options.no_strip else "")
        stages = watched_stages()
        window = MainWindow(preset, settings, Path(folder), backend=options.backend)
        window.set_theme(cast(ThemeChoice, options.theme), remember=False)
        width, height = (int(part) for part in options.size.split("x"))
        window.resize(width, height)
        window.error_hook.install()
        meter = Meter(window, options.seconds, stages) if not options.compare else None
        window.show()
        window.open_source(options.source)
        if options.against:
            other = Side(options.against, load_preset(options.against))
            window.context.comparison.show(window.context.comparison.present, other)
        measured = meter or Rounds(window, options.compare, options.seconds)
        application.exec()
    sys.stdout.write(
        f"machine           {os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, Python {platform.python_version()}, "
        f"{application.platformName()}\n{measured.report()}\n"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
