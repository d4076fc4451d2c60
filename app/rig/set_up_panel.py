"""The controls of the mode *Set up*: the steps from cameras to a judged preset, each with its state and its button."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Final

from PyQt6.QtCore import Qt, QTimer
from PyQt6.QtGui import QAction, QPalette
from PyQt6.QtWidgets import QAbstractButton, QFrame, QScrollArea, QStackedLayout, QWidget

from ...core.contact.checks import check_rig, check_test, homography_notes
from ...core.errors import RigMismatchError, counted
from ...core.model.frames import SensorFrame
from ...core.preset import Preset
from ...core.rig.untouched import place_at_rest
from ...core.sources.base import part_of
from ...core.sources.registry import open_source, opens_by_name
from ...widgets.basics.controls import ElidedLabel, NoteLabel, TintedLabel, action_button, heading, push_button
from ...widgets.basics.layouts import STRETCH, hbox, holding, vbox
from ...widgets.basics.theme import text_font
from ..calibration.measuring_step import OTHER_SOURCE
from ..context import Context
from ..sources.cameras_page import CAMERAS
from ..worker.jobs import Job, Progress
from ..worker.results import SourceInfo
from .set_up_steps import AlignmentStep, BiasStep, NoiseStep, SetUpStep, SuggestStep, VerdictStep
from .untouched import UntouchedStep

_LEFT_OUT: Final = "Left out: this rig has one camera."


def _find_rest(name: str, progress: Progress) -> int:
    with open_source(name, part_of(progress, 0, 2)) as source:
        return place_at_rest(source, part_of(progress, 1, 2))


class StepRow(QFrame):
    """One step: its mark, title and buttons, and below them its state, or progress and *Cancel* while it runs.

    ``title``, ``intro`` and ``known`` are as in `SetUpStep`. Opening a source is a step without work of its own.
    """

    def __init__(
        self,
        title: str,
        intro: str,
        known: Callable[[Preset], str],
        work: SetUpStep | None = None,
        more: Sequence[QAbstractButton] = (),
    ) -> None:
        super().__init__()
        self.title, self._intro, self.known, self.work = title, intro, known, work
        self.skipped = False
        self.mark = TintedLabel()
        self.mark.setFixedWidth(self.mark.fontMetrics().horizontalAdvance("MM"))
        self.state = ElidedLabel()
        self.state.setAccessibleName(title)
        self.setAccessibleName(title)
        below = QWidget()
        self._stack = QStackedLayout(below)
        self._stack.addWidget(self.state)
        if work is not None:
            work.setParent(self)
            work.hide()
            self._stack.addWidget(holding(hbox((work.progress, 1), work.cancel, margins=0)))
            below.setFixedHeight(work.cancel.sizeHint().height())
            work.progress.setAccessibleName(f"Progress of {title.lower()}")
        buttons = [*([] if work is None else [work.start]), *more]
        head = hbox(self.mark, heading(title), STRETCH, *buttons, margins=0, spacing=6)
        vbox(head, hbox(self.mark.width(), (below, 1), margins=0), within=self, margins=(6, 4, 6, 4), spacing=0)

    @property
    def failure(self) -> str:
        """Why the newest try failed or ended; empty if it has not."""
        return "" if self.work is None or self.work.found is not None else self.work.sentence.text()

    def show_state(self, preset: Preset, left_out: bool, following: bool) -> None:
        """Show the state; ``following`` is the one next step."""
        known, failed = self.known(preset), self.failure
        busy = self.work is not None and self.work.busy
        self.setToolTip("" if self.work is None else self.work.sentence.text())  # what was found, in whole sentences
        skipped = "Skipped." if self.skipped and not known else ""
        self._stack.setCurrentIndex(int(busy))
        self.mark.setText("–" if left_out or skipped else "…" if busy else "!" if failed else "✓" if known else "○")
        self.mark.tint("error" if failed else "accent" if known else "")
        self.state.setText(_LEFT_OUT if left_out else failed or known or skipped or self._intro)
        self.setAutoFillBackground(following)
        self.setBackgroundRole(QPalette.ColorRole.AlternateBase)


def _row(step: SetUpStep, *more: QAbstractButton) -> StepRow:
    return StepRow(step.title, step.intro, step.known, step, more)


class SetUpPanel(QWidget):
    """*Set up this rig* runs step after step by itself, and stops where a person must act or where a step fails."""

    def __init__(self, context: Context, actions: Mapping[str, QAction]) -> None:
        super().__init__()
        self._context = context
        self._info: SourceInfo | None = None
        self.running = self._waiting = False
        self._again: set[StepRow] = set()
        self._chosen: StepRow | None = None
        self._opening = ""  # name of the source that is being opened
        self._place: int | None = None  # in a recording, where nothing touches the membrane
        self._search = Job(self, done=self._found_rest, failed=self._search_failed)
        document = context.document
        #: The frames of the newest press.
        self.press: list[SensorFrame] = []
        opens = [action_button(actions[name], with_text=True) for name in ("open_source", "cameras")]
        self.source = StepRow("Source", "Nothing is open.", lambda _: self._opened_source(), more=opens)
        self.untouched = _row(UntouchedStep(context))
        self.noise = _row(NoiseStep(context))
        self.alignment = _row(AlignmentStep(context), action_button(actions["calibrate"], with_text=True))
        self.bias = _row(BiasStep(context, self.press))
        self.suggestions = _row(SuggestStep(context, self.press))
        self.verdict = _row(VerdictStep(context, self.press))
        self.rows = (self.source, self.untouched, self.noise, self.alignment, self.bias, self.suggestions, self.verdict)
        self._steps = [(row, row.work) for row in self.rows if row.work is not None]
        self.start = push_button("Set &up this rig", "Run all open steps in their order; stops where you must act")
        self.start.setFont(text_font("body", bold=True))
        self.skip = push_button("S&kip step", "Go on without the marked step")
        self.start.setDefault(True)
        self.headline = NoteLabel(lines=4)
        self.save = action_button(actions["save"], with_text=True)
        self.save.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextOnly)  # an icon is dark, also on blue
        top, bottom = hbox((self.start, 1), self.skip, margins=0), hbox(STRETCH, self.save, margins=0)
        vbox(top, self.headline, *self.rows, bottom, STRETCH, within=self, margins=8, spacing=2)
        self.setAccessibleName("Set up")
        self.start.clicked.connect(self.toggle)
        self.skip.clicked.connect(self._skip)
        for _, work in self._steps:
            work.ended.connect(self._step_ended)
            work.start.clicked.connect(self._show)
        context.worker.opened.connect(self._opened)
        context.worker.opening.connect(lambda name, *_: self._show_opening(name))
        context.worker.openFailed.connect(lambda *_: self._show_opening(""))
        context.worker.openFailed.connect(lambda *_: self._go_on(False))
        context.frameShown.connect(lambda: self._go_on(True))
        document.presetChanged.connect(self._show)
        document.fileChanged.connect(self._show)
        self._show()

    def choose(self, row: StepRow) -> None:
        """Come to a step: its button has the focus, so that Enter begins it."""
        self._chosen = row
        above = self.parentWidget()
        while above is not None and not isinstance(above, QScrollArea):
            above = above.parentWidget()
        if above is not None:
            above.ensureWidgetVisible(row)
        if row.work is not None:
            row.work.start.setFocus(Qt.FocusReason.ShortcutFocusReason)
        self._show()

    def toggle(self) -> None:
        """Run the open steps, or all of them again if none is open; or stop."""
        if self.running:
            self.stop()
            return
        self._chosen, following = None, self._next()
        if following is None:
            self._again = {row for row, _ in self._steps}
            self.press.clear()
        self.running = True
        self._advance()

    def stop(self) -> None:
        if self._waiting:
            self._context.worker.cancel_open()
        self.running = self._waiting = False
        self._search.cancel()
        for _, work in self._steps:
            work.stop()
        self._show()

    def close(self) -> bool:
        """Take no frames any more."""
        self.running = False
        self._search.stop()
        for _, work in self._steps:
            work.close_down()
        return super().close()

    def _left_out(self, row: StepRow) -> bool:
        one_camera = self._info is not None and not self._info.rig.has_proximity
        return one_camera and row.work is not None and row.work.two_cameras

    def _next(self) -> StepRow | None:
        """Return the chosen step, or the first one that is open; None if the rig is set up."""
        if self._info is None:
            return self.source
        if self._chosen is not None:
            return self._chosen
        preset = self._context.document.preset
        for row in self.rows[1:]:
            if not self._left_out(row) and not row.skipped and (row in self._again or not row.known(preset)):
                return row
        return None

    def _advance(self) -> None:
        """Begin the next step; without a source, open the cameras."""
        row = self._next()
        if not self.running or row is None:
            self.running = False
        elif row.work is None:
            self._waiting = True  # for the first frame
            self._context.sourceRequested.emit(CAMERAS)
        elif row not in (self.untouched, self.noise) or self._at_rest(self._info):
            row.work.begin()
        self._show()

    def _at_rest(self, info: SourceInfo | None) -> bool:
        """Whether the source is where nothing touches the membrane; in a recording, go there and come again."""
        result, worker = self._context.result, self._context.worker
        if info is None or result is None or info.length is None or not opens_by_name(info.name):
            return True
        if info.name.startswith("sim:"):
            return True  # it takes its object away
        if self._place is None:
            self._search.start(partial(_find_rest, info.name))
            return False
        if result.frame_number == self._place:
            return True
        self._waiting = True
        worker.pause()
        worker.seek(self._place)
        return False

    def _found_rest(self, place: int | None) -> None:
        if place is None:
            self.running = False
        self._place = place
        self._advance()

    def _search_failed(self, sentence: str) -> None:
        self._found_rest(None)
        self.headline.setText(sentence)

    def _step_ended(self, found: bool) -> None:
        row = next(row for row, work in self._steps if work is self.sender())
        self._chosen = None
        if found:
            self._again.discard(row)
            row.skipped = False
        elif not row.skipped:
            self.press.clear()  # the next try looks at another one
        self.running = self.running and (found or row.skipped)
        if self.running:
            QTimer.singleShot(0, self._advance)
        self._show()

    def _go_on(self, opened: bool) -> None:
        """After the cameras were opened by this run: begin, or stop."""
        if self._waiting:
            self._waiting = False
            self.running = self.running and opened
            self._advance()

    def _skip(self) -> None:
        row, self._chosen = self._next(), None
        if row is not None and row.work is not None:
            self._again.discard(row)
            row.skipped = True
            row.work.stop()
            self.running = self._next() is not None
            self._advance()

    def _opened(self, info: SourceInfo) -> None:
        """Begin again: what other cameras or another recording showed does not hold here."""
        self._info, self._again, self._chosen, self._place = info, set(), None, None
        self._opening = ""
        self.press.clear()
        self._search.cancel()
        for row, work in self._steps:
            row.skipped, work.found = False, None
            if work.sentence.text() != OTHER_SOURCE:
                work.sentence.clear()
        self._show()

    def _show_opening(self, name: str) -> None:
        if name != self._opening:
            self._opening = name
            self._show()

    def _opened_source(self) -> str:
        info = self._info
        if info is None:
            return ""
        return f"{info.name}, {'live' if info.length is None else counted(info.length, 'frame')}."

    def _show(self, *_: object) -> None:
        preset, following = self._context.document.preset, self._next()
        busy = any(work.busy for _, work in self._steps)
        for row in self.rows:
            row.show_state(preset, self._left_out(row), row is following)
        for row, work in self._steps:
            work.start.setEnabled(not busy and self._info is not None and not self._left_out(row))
            work.cancel.setVisible(not self.running)  # Stop does the same
        self.start.setText("Stop" if self.running else "Set &up again" if following is None else "Set &up this rig")
        self.start.setEnabled(self.running or not busy)
        self.skip.setEnabled(self.start.isEnabled() and following is not None and following.work is not None)
        opening = f"Opening {self._opening}…" if self._opening and self._info is None else ""
        self.source.state.setText(opening or self.source.state.text())
        self.headline.setText(opening or self._headline(following))
        saves = following is None and self._context.document.dirty  # the next step is blue
        self.start.setDefault(following is not None)
        if self.save.property("primary") != saves:
            self.save.setProperty("primary", saves)
            if (style := self.save.style()) is not None:
                style.polish(self.save)

    def _of_another_rig(self) -> bool:
        preset, info = self._context.document.preset, self._info
        if info is None:
            return False
        try:
            check_test(preset, info.rig)
            return check_rig(preset, info.rig) != homography_notes(preset)
        except RigMismatchError:
            return True

    def _headline(self, following: StepRow | None) -> str:
        if self._waiting or self._search.busy:
            return "Looking for cameras." if self._info is None else "Looking for the untouched membrane."
        document = self._context.document
        if following is None:
            if self._of_another_rig():
                return "This preset was made for another rig. Next: set up again, or open its preset (Ctrl+Shift+O)."
            judged = "" if document.preset.verdict is None else document.preset.verdict.sentence
            save = "Save the preset; its untouched frame is a second file beside it."
            return f"{judged} {save if document.dirty else 'Next: record and run (Ctrl+3).'}".strip()
        if following.work is not None and following.work.busy:
            return f"{following.work.doing}."
        return following.failure or f"Next: {following.title.lower()}."
