"""The tab Tune: a search for preset values on the open recording, and the trials that no other beats."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from PyQt6.QtCore import QObject, QProcess, Qt, pyqtSignal
from PyQt6.QtWidgets import QCheckBox, QFormLayout, QLabel, QSpinBox

from ...core.contact.kernels.threads import available_threads
from ...core.errors import PresetError, TactuneError, as_sentence, counted, minus
from ...core.preset import Preset
from ...core.preset.file import save_preset
from ...core.tuning.plan import Axis, default_axes
from ...widgets.basics.controls import ElidedLabel, named, push_button
from ...widgets.basics.fields import field_spec, format_number
from ...widgets.basics.layouts import STRETCH, hbox, holding, scrolling, splitter, vbox
from ...widgets.basics.messages import Messages, Severity
from ...widgets.basics.record_table import Column, RecordTable
from ..context import Context
from ..document.comparison import Side
from ..document.document import field_title
from ..worker.results import Result
from .tab import AnalysisTab


def _name(trial: dict[str, Any]) -> str:
    return "Present preset" if trial["present"] else f"Trial {trial['number']}"


def _values(trial: dict[str, Any]) -> str:
    return ", ".join(
        f"{field_title(path)} {field_spec(Preset, path).describe(value)}" for path, value in trial["values"].items()
    )


_COLUMNS: Final = (
    Column("Trial", _name, "Number of the trial", sample="Present preset"),
    Column(
        "Error", lambda trial: trial["figures"].get("rmse", trial["figures"].get("stability")),
        "RMSE in mm with ground truth, else how much the patch changes while nothing moves", 3,
    ),
    Column("ms", lambda trial: trial["figures"]["ms"], "Time per frame on one thread, milliseconds", 2),
    Column("Values", _values, hint=_values, stretch=True),
)  # fmt: skip
_WAITING = "Waiting for a frame: open a recording, a folder or the simulator in the main window."
_READY = "Start searches the ticked fields for less error and less time. The present preset is the first trial."
_LIVE = "A live source is never the same twice: record it first, then open the recording."
_PANEL_WIDTH = 300
#: Exit status after a stop by the person.
_STOPPED = 130
#: Longest wait for the killed process when the window closes, ms; at its low priority it may end later.
_END_MS = 3_000
#: Killed processes that have not ended yet: Qt would wait for them if it deleted them before.
_ending: list[QProcess] = []


@dataclass(frozen=True)
class Request:
    """What to search: a source, the start, the ranges of the fields, and what is optimised beside the time."""

    source: str
    preset: Preset
    axes: tuple[Axis, ...]
    objective: str
    frames: range
    trials: int


class TuneRun(QObject):
    """One search at a time. One that was stopped continues where it ended, if nothing in the request has changed."""

    #: There are more `trials`, or another `front`.
    changed = pyqtSignal()
    #: The search is over; the sentence says what went wrong, or is empty.
    ended = pyqtSignal(str)

    def __init__(self, folder: Path, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._folder = folder
        self._process: QProcess | None = None
        self.request: Request | None = None
        #: The measured trials by number, with ``values``, ``figures``, ``failure`` and ``present``.
        self.trials: dict[int, dict[str, Any]] = {}
        self.front: tuple[int, ...] = ()
        self.stopping = False

    @property
    def busy(self) -> bool:
        return self._process is not None

    def start(self, request: Request) -> None:
        """Begin or continue a search; forget the former one's trials."""
        self.request, self.trials, self.front, self.stopping = request, {}, (), False
        name = hashlib.sha256(request.source.encode()).hexdigest()[:12]
        preset = self._folder / f"{name}.preset.json"
        save_preset(request.preset, preset)
        frames = request.frames
        words = ["-P", "-m", "tactune.app", "tune", "--json", "--source", request.source, "--preset", str(preset)]
        words += ["--objective", f"{request.objective},ms", "--trials", str(request.trials)]
        words += ["--frames", f"{frames.start}:{frames.stop}:{frames.step}"]
        words += ["--study", str(self._folder / f"{name}.study.log")]
        words += ["--jobs", str(max(1, available_threads() - 1))]
        for axis in request.axes:
            words += ["--set", f"{axis.path}={axis.low!r}:{axis.high!r}{':log' if axis.log else ''}"]
        command = [sys.executable, *words]
        if (nice := shutil.which("nice")) is not None:
            command = [nice, "-n", "19", *command]  # with 10 the window loses a quarter of its frames on two cores
        self._process = process = QProcess(self)
        process.readyReadStandardOutput.connect(self._read)
        process.finished.connect(self._finished)
        process.start(command[0], command[1:])
        self.changed.emit()

    def stop(self) -> None:
        """Stop the search; its trials are kept. `ended` follows."""
        if self._process is not None:
            self.stopping = True
            self._process.terminate()

    def shut_down(self) -> None:
        """End the process now; emit nothing any more. Its measured trials are kept."""
        self.blockSignals(True)
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            if not process.waitForFinished(_END_MS):
                process.setParent(None)
                _ending.append(process)
                process.finished.connect(process.deleteLater)
                process.finished.connect(lambda: _ending.remove(process))

    def _read(self) -> None:
        while self._process is not None and self._process.canReadLine():
            line = json.loads(self._process.readLine().data())
            if "number" in line:
                self.trials[line["number"]] = line
            elif "front" in line:
                self.front = tuple(line["front"])
        self.changed.emit()

    def _finished(self, status: int) -> None:
        self._read()
        process, self._process = self._process, None
        if process is None:
            return
        said = bytes(process.readAllStandardError().data()).decode(errors="replace").strip().splitlines()
        process.deleteLater()
        well = status in (0, _STOPPED) or self.stopping
        unsaid = f"the search was ended (status {status}); its trials are kept, Start continues"
        last = said[-1].removeprefix("tactune: ") if said else unsaid
        self.ended.emit("" if well else as_sentence(last))


def frames_of(trim: Sequence[int] | None, length: int, count: int, index: int, has_truth: bool) -> range:
    """Return the frames to search on within ``trim``: spread evenly with truth, else in a row, for stability."""
    first, end = trim or (0, length)
    count = min(count, end - first)
    if has_truth:
        step = max(1, (end - first) // count)
        return range(first, min(end, first + step * count), step)
    start = min(max(first, index), end - count)
    return range(start, start + count)


class TuneTab(AnalysisTab):
    """Starts a search, lists its best trials, previews one, and puts it into the preset."""

    def __init__(self, context: Context) -> None:
        super().__init__()
        self._context, self._document = context, context.document
        self._result: Result | None = None
        self._previewed: Side | None = None
        self.run = TuneRun(context.data_folder / "searches", self)
        tip = "Trials that no other beats in error and time. Choose one to preview it; Enter uses it"
        self.table = RecordTable(_COLUMNS, "Best trials", tip, key=lambda trial: trial["number"], sortable=True)
        self.status = ElidedLabel(_WAITING)
        self.messages = Messages(self.table)
        self.fields: dict[str, QCheckBox] = {}
        self._axes: dict[str, Axis] = {}
        self.trials, self.frames = QSpinBox(), QSpinBox()
        self.start = push_button(
            "Sta&rt", "Search the ticked fields on the open recording (Ctrl+Return)", "Ctrl+Return"
        )
        self.stop = push_button("Sto&p", "Stop the search. Its trials are kept: Start continues it (Alt+P)")
        self.use = push_button("&Use", "Put the chosen trial's values into the preset, as one undo step (Return)")
        self._field_box = holding(vbox(margins=0, spacing=4))
        self._lay_out()
        self.start.clicked.connect(self._start)
        self.stop.clicked.connect(self._stop)
        self.use.clicked.connect(self._use)
        self.table.activated.connect(lambda _: self._use())
        self.table.selectionEdited.connect(lambda _: self._preview())
        self.run.changed.connect(self._show_trials)
        self.run.ended.connect(self._ended)
        self._document.presetChanged.connect(self._list_fields)
        self._document.baselineChanged.connect(self._list_fields)
        self._list_fields(self._document.preset)

    def show_result(self, result: Result) -> None:
        new = self._result is None or result.source is not self._result.source
        self._result = result
        if new:
            self._update()

    def shut_down(self) -> None:
        self.run.shut_down()

    def _lay_out(self) -> None:
        self.trials.setRange(1, 10_000)
        self.trials.setValue(60)
        named(self.trials, "Trials", "Number of trials. More find better values; a larger number continues the search")
        self.frames.setRange(1, 1000)
        self.frames.setValue(8)
        named(
            self.frames,
            "Frames",
            "Number of frames of each trial, between the in and out marks: spread evenly with ground truth, otherwise "
            "consecutive from the present frame. More are more reliable and take longer",
        )
        form = QFormLayout()
        form.addRow("Tria&ls", self.trials)
        form.addRow("&Frames", self.frames)
        buttons = hbox(self.start, self.stop)
        fields = vbox(QLabel("Fields to search:"), self._field_box, spacing=4)
        panel = holding(vbox(fields, form, buttons, 12, self.use, STRETCH, margins=(0, 0, 4, 0)))
        across = splitter(Qt.Orientation.Horizontal, scrolling(panel, _PANEL_WIDTH), (self.table, 1))
        vbox(self.status, (across, 1), within=self, margins=0)

    def _list_fields(self, preset: Preset) -> None:
        self._axes = {axis.path: axis for axis in default_axes(preset)}
        layout = self._field_box.layout()
        assert layout is not None
        for path in self.fields.keys() - self._axes.keys():
            self.fields.pop(path).deleteLater()
        for axis in self._axes.values():
            if axis.path not in self.fields:
                box = self.fields[axis.path] = QCheckBox()
                box.setChecked(True)
                box.toggled.connect(self._update)
                layout.addWidget(box)
            box, spec = self.fields[axis.path], field_spec(Preset, axis.path)
            ends = " to ".join(minus(format_number(end * spec.factor)) for end in (axis.low, axis.high))
            box.setText(f"{spec.title}: {ends}{spec.suffix}")
            box.setToolTip(f"{spec.description} Without the tick it keeps its value.")
        self._update()

    # Searching

    def _start(self) -> None:
        result = self._result
        assert result is not None and result.source.length is not None  # else Start is disabled
        self.messages.clear("failed")
        self._end_preview()
        axes = tuple(self._axes[path] for path, box in self.fields.items() if box.isChecked())
        has_truth = result.frame.truth is not None
        objective = "rmse" if has_truth else "stability"
        index = max(0, result.frame_number)
        frames = frames_of(self._context.trim, result.source.length, self.frames.value(), index, has_truth)
        request = Request(result.source.name, self._document.preset, axes, objective, frames, self.trials.value())
        try:
            self.run.start(request)
        except TactuneError as error:
            self._ended(str(error))

    def _stop(self) -> None:
        self.run.stop()
        self._update()

    def _ended(self, sentence: str) -> None:
        if sentence:
            self.messages.show_message("failed", Severity.ERROR, sentence)
        self._show_trials()

    def _show_trials(self) -> None:
        shown = [trial for number, trial in self.run.trials.items() if number in self.run.front or trial["present"]]
        self.table.set_records([trial for trial in shown if not trial["failure"] and trial["figures"]["points"]])
        self._update()

    def _update(self) -> None:
        """Enable what is possible now and say what happens."""
        source = None if self._result is None else self._result.source
        request, busy, done = self.run.request, self.run.busy, len(self.run.trials)
        if request is not None and (busy or done):
            now = "Stopping… " if self.run.stopping and busy else "Searching… " if busy else ""
            best = counted(len(self.run.front), "best trial")
            words = f"{now}{done} of {request.trials} trials on {request.source}; {best}"
        else:
            words = _WAITING if source is None else _LIVE if source.length is None else _READY
        failed = sum(bool(trial["failure"]) for trial in self.run.trials.values())
        self.status.setText(words + (f" ({failed} failed)" if failed else ""))
        ticked = any(box.isChecked() for box in self.fields.values())
        self.start.setEnabled(not busy and source is not None and source.length is not None and ticked)
        self.stop.setEnabled(busy and not self.run.stopping)
        for entry in (self._field_box, self.trials, self.frames):
            entry.setEnabled(not busy)
        trial = self._chosen()
        self.use.setText("&Use" if trial is None else f"&Use trial {trial['number']}")
        self.use.setEnabled(bool(self._changes()))

    # The chosen trial

    def _chosen(self) -> dict[str, Any] | None:
        return next((self.run.trials.get(number) for number in self.table.selected_keys()), None)

    def _changes(self) -> dict[str, Any]:
        trial, request = self._chosen(), self.run.request
        if trial is None or request is None:
            return {}
        values = {"contact_test": request.preset.contact_test} | trial["values"]
        return {path: value for path, value in values.items() if value != self._document.preset.value(path)}

    def _preview(self) -> None:
        self._update()
        comparison, trial = self._context.comparison, self._chosen()
        if trial is None:
            return
        try:
            preset = self._document.preset.with_values(self._changes())
        except PresetError as error:  # the preset was edited since the search
            self.messages.show_message("preview", Severity.WARNING, f"{_name(trial)} cannot be previewed: {error}")
            return
        self._previewed = Side(_name(trial), preset)
        comparison.show(comparison.present, self._previewed)

    def _end_preview(self) -> None:
        if self._context.comparison.shows(self._previewed):
            self._context.comparison.end()
        self._previewed = None

    def _use(self) -> None:
        changes, trial = self._changes(), self._chosen()
        if trial is None or not changes:
            return
        name = _name(trial)
        self._end_preview()
        if self._document.edit_many(changes, title=f"{name} of the search"):
            self.messages.show_message("used", Severity.INFO, f"{name} is in the preset. Undo: Ctrl+Z.")
        self._update()
