"""The window of the calibration wizard, with four steps in any order, and its launcher."""

from __future__ import annotations

from datetime import datetime
from functools import partial
from pathlib import Path

from PyQt6.QtCore import QObject, Qt
from PyQt6.QtGui import QAction, QCloseEvent, QKeyEvent, QKeySequence, QShortcut
from PyQt6.QtWidgets import QButtonGroup, QDialog, QStackedWidget, QToolButton, QWidget

from ...core.calibration.check import compare_alignments, is_worse
from ...core.calibration.points import read_points, write_points
from ...core.calibration.report import CalibrationReport, grade
from ...core.errors import counted
from ...core.model.frames import Rig
from ...widgets.basics.controls import NoteLabel, action_button, choice_button, push_button, wrapped_label
from ...widgets.basics.dialogs import bring_up
from ...widgets.basics.layouts import STRETCH, hbox, holding, vbox
from ...widgets.basics.messages import Messages, Severity
from ..context import SOURCE, TASK, Context
from .check_page import CheckPage
from .fitting import Fitter, Outcome, at_least, missing_pairs, report_changes, with_depth
from .frames_page import FramesPage
from .keeping import Keeper
from .points_page import PointsPage
from .quality_page import QualityPage
from .session import Session, SessionState

STEPS = ("Snapshots", "Points", "Quality", "Save")
_TIPS = (
    "Take snapshots of the membrane, at one or several inflation levels",
    "Find points automatically, or click the same spots in both images",
    "Quality of the calibration, the next step, and the choice of the model",
    "Compare the new alignment with the present one, and save it",
)
_SAVE = STEPS.index("Save")
_WORSE = "The present alignment is expected to be better than the new one."
_POINTS = "Points (*.csv)"


class CalibrationWizard(QDialog):
    """Leads from frames of a source to an alignment in the document. Closing it loses nothing: a file keeps it."""

    def __init__(self, context: Context, rig: Rig) -> None:
        super().__init__(context.window)
        self.setWindowTitle("Calibrate")
        self.setWindowFlag(Qt.WindowType.WindowMaximizeButtonHint)
        self._context, self._document = context, context.document
        self._dialogs = context.dialogs.over(self)
        self.outcome = Outcome()
        self._saved = False
        self.session = Session(rig, self)
        self.keeper = Keeper(self.session, context.data_folder / "calibration", self)
        self.fitter = Fitter(self.session, self)
        self.frames = FramesPage(self.session, context)
        self.points = PointsPage(self.session)
        self.quality = QualityPage(self.session)
        self.check = CheckPage(self.session, context.document)
        self.pages: tuple[QWidget, ...] = (self.frames, self.points, self.quality, self.check)
        #: What a page offers to do before *Next*; both stand at the same place on every page.
        self.page_actions = {0: self.frames.take, 1: self.points.finder.search}
        self._lay_out()
        self._connect()
        self.resize(1240, 760)
        kept_at = self.keeper.restore()
        self.go_to(1 if self.session.state.snapshots and not self._elsewhere() else 0)
        if kept_at is not None:
            self._say_restored(kept_at)

    # Building

    def _lay_out(self) -> None:
        self.steps = QButtonGroup(self)
        buttons = []
        for number, (name, tip) in enumerate(zip(STEPS, _TIPS, strict=True)):
            keys = f"Ctrl+{number + 1}"
            button = choice_button(f"&{number + 1}  {name}", f"{tip} ({keys})", keys)
            button.setFlat(True)  # as the modes of the main window
            button.setMinimumHeight(30)
            button.setMinimumWidth(124)
            self.steps.addButton(button, number)
            buttons.append(button)
        self.over = push_button("Start o&ver", "Clear the wizard; undo restores everything until it is closed")
        stack = self.session.undo_stack
        self.undo = self._step_button("Undo", stack.createUndoAction(self), "Ctrl+Z")
        self.redo = self._step_button("Redo", stack.createRedoAction(self), "Ctrl+Shift+Z", "Ctrl+Y")
        self.stack = QStackedWidget()
        for page in self.pages:
            self.stack.addWidget(page)
        self.verdict = wrapped_label()
        self.back = push_button("&Back", "To the step before (Ctrl+Page Up)", "Ctrl+PgUp")
        self.next = push_button("&Next", "To the next step (Ctrl+Page Down)", "Ctrl+PgDown")
        self.save = push_button(
            "S&ave preset", "Put the alignment with its points and quality into the preset, and save its file (Ctrl+S)"
        )
        self.leave = push_button("&Close", "Close the wizard; everything is saved and restored next time")
        for push in (*self.page_actions.values(), self.next, self.save):
            push.setMinimumWidth(120)
            push.setProperty("wide", True)  # a style sheet's width wins over the one above
        area = holding(vbox(self.stack, margins=0))
        self.messages = Messages(area, self._below_views)
        self.restored = NoteLabel()
        self.restored.hide()
        top = hbox(*buttons, STRETCH, self.over, self.undo, self.redo, spacing=4)
        footer = hbox((self.verdict, 1), self.leave, self.back, *self.page_actions.values(), self.next, self.save)
        vbox(top, self.restored, (area, 1), footer, within=self, margins=8, spacing=4)

    def _step_button(self, name: str, action: QAction | None, *keys: str) -> QToolButton:
        """Return the button of an action of the undo stack, whose tooltip says what it would do, with its key."""
        assert action is not None
        action.changed.connect(lambda: action.setToolTip(f"{action.text()} ({keys[0]})"))
        action.setIconText(name)
        action.setShortcuts([QKeySequence(each) for each in keys])
        return action_button(action, with_text=True)

    def _connect(self) -> None:
        session = self.session
        self.steps.idClicked.connect(self.go_to)
        self.back.clicked.connect(lambda: self.go_to(self.stack.currentIndex() - 1))
        self.next.clicked.connect(lambda: self.go_to(self.stack.currentIndex() + 1))
        self.over.clicked.connect(self.start_over)
        self.save.clicked.connect(self.save_preset)
        self.leave.clicked.connect(self.close)
        self.points.load.clicked.connect(
            lambda: self._dialogs.open_file("points", "Import points", _POINTS, self.import_points)
        )
        self.points.store.clicked.connect(
            lambda: self._dialogs.save_file("points", "Export points", "points.csv", [_POINTS], self.export_points)
        )
        self.points.split.splitterMoved.connect(self.messages.arrange)
        self.keeper.failed.connect(lambda words: self.messages.show_message("keeping", Severity.WARNING, words))
        self.fitter.fitted.connect(self._show_outcome)
        self._document.refused.connect(self._refused)
        self._document.fileChanged.connect(self._file_changed)
        for changed in (
            *(session.changed, self.fitter.job.busyChanged, self.points.finder.job.busyChanged),
            *(self._document.presetChanged, self._document.fileChanged),
        ):
            changed.connect(self._show_steps)
        QShortcut(QKeySequence("Ctrl+S"), self).activated.connect(self.save_preset)  # on each page

    # Steps

    def _below_views(self) -> int:
        """Return the height below the images of a page, where messages must not cover anything."""
        views: dict[QWidget | None, QWidget] = {self.points: self.points.views, self.check: self.check.image}
        view = views.get(self.stack.currentWidget())
        return 0 if view is None else self.stack.height() - view.mapTo(self.stack, view.rect().bottomLeft()).y()

    def go_to(self, number: int) -> None:
        """Show a step."""
        number = max(0, min(number, len(STEPS) - 1))
        self.stack.setCurrentIndex(number)
        self.restored.hide()
        self.messages.arrange()
        button = self.steps.button(number)
        assert button is not None
        button.setChecked(True)
        self.pages[number].setFocus()
        self.back.setEnabled(number > 0)
        self._show_steps()

    def start_over(self) -> None:
        """Clear the session, as one undoable step."""
        self.session.edit("Start over", SessionState())
        self.go_to(0)

    def _elsewhere(self) -> bool:
        """Tell whether the snapshots are all of other sources than the open one."""
        sources = self.session.state.sources
        return bool(sources) and self._context.source_name not in sources

    def _say_restored(self, kept_at: datetime) -> None:
        """Say until the next step what was restored, and that it is of another source: so may be its membrane."""
        state, elsewhere = self.session.state, self._elsewhere()
        of = f" of {', '.join(state.sources)}" if state.sources else ""
        held = f"{counted(len(state.complete_pairs), 'pair')}, {counted(len(state.snapshots), 'snapshot')}"
        words = f"Restored the calibration{of} from {kept_at.astimezone():%d %B, %H:%M}: {held}."
        if elsewhere:
            words += f" {self._context.source_name} is open now: take new snapshots, or start over."
            self.restored.tint("warning")
        self.restored.setText(words)
        self.restored.show()

    def _show_outcome(self, outcome: Outcome) -> None:
        self.outcome, self._saved = outcome, False
        for page in (self.points, self.quality, self.check):
            page.show_outcome(outcome)
        self._show_steps()

    def _missing(self, step: int) -> str:
        """Say what a step lacks before the next one makes sense; empty if nothing."""
        state = self.session.state
        if step == 0:
            return "" if state.snapshots or state.pairs else "No snapshot yet: hold the membrane still and take one."
        if self.points.finder.job.busy:
            return "The search for points is not complete yet: wait for it, or cancel it."
        few = missing_pairs(state)
        if few:
            return f"{few} Press Find points, or click them in both images."
        return "" if self.outcome.report is not None or self.fitter.job.busy else self.outcome.problem

    def _findings(self) -> dict[str, str]:
        """Say by step what is to be looked at; empty for nothing."""
        report = self.outcome.report
        if report is None:
            return {"Points": self.outcome.problem if self.session.state.pairs else ""}
        rejected, judged = self.outcome.rejected, grade(report.chosen)
        unusual = "" if report.model == report.recommended else report.reason
        worse = is_worse(report, self._document.preset)
        return {
            "Points": f"{counted(len(rejected), 'rejected pair')}." if rejected else "",
            "Quality": unusual if judged.startswith(("Good", "Usable")) else judged,
            "Save": _WORSE if worse else "",
        }

    def _done(self, step: int) -> bool:
        if step == 0:
            return bool(self.session.state.snapshots)
        if step == _SAVE:
            return self._saved and not self._document.dirty
        return self.outcome.report is not None

    def _show_steps(self, _: object = None) -> None:
        """Show what is done and what needs attention on the step buttons, and what the page on top lacks."""
        self.over.setEnabled(not self.session.state.empty)
        findings = self._findings()
        for step, (name, tip) in enumerate(zip(STEPS, _TIPS, strict=True)):
            button, attention = self.steps.button(step), findings.get(name, "")
            assert button is not None
            sign, status = ("!", attention) if attention else ("✓", "Done.") if self._done(step) else ("", "")
            button.setText(f"&{step + 1}  {name}  {sign}".strip())
            button.setToolTip(f"{sign} {status}\n{tip} (Ctrl+{step + 1})".strip())
            button.setAccessibleName(f"Step {step + 1}, {name}. {status}".strip())
        step, report = self.stack.currentIndex(), self.outcome.report
        missing = self._missing(step)
        fitted = self.outcome.problem if report is None else _short(report)
        self.verdict.setText(missing or ("Fitting…" if self.fitter.job.busy else fitted))
        self.next.setEnabled(not missing)
        self.save.setEnabled(report is not None and not self.fitter.job.busy)
        action, onward = self.page_actions.get(step), self.save if step == _SAVE else self.next
        following = self.leave if step == _SAVE and self._done(_SAVE) else action if missing and action else onward
        for push in (*self.page_actions.values(), self.next, self.save):
            push.setVisible(push in {action, onward})
        for push in (*self.page_actions.values(), self.leave, self.next, self.save):
            push.setDefault(push is following)

    # Files

    def import_points(self, path: Path) -> None:
        with self.messages.telling("file"):
            pairs = with_depth(read_points(path), self.session.state, self.session.rig, origin=path.name)
            self.session.add_pairs(pairs, f"Import {len(pairs)} pairs")
            self.messages.show_message("file", Severity.INFO, f"{len(pairs)} pairs were read from {path}.")

    def export_points(self, path: Path) -> None:
        with self.messages.telling("file"):
            write_points(path, self.session.state.complete_pairs)
            self.messages.show_message("file", Severity.INFO, f"The pairs were written to {path}.")

    def save_preset(self) -> None:
        """Put the alignment into the preset and save its file; ask first if it is worse than the present one."""
        report = self.outcome.report
        if report is None or self.fitter.job.busy:
            return
        if not is_worse(report, self._document.preset):
            self._save(report)
            return
        preset = self._document.preset
        compared, record = compare_alignments(report, preset), preset.alignment.calibration
        words = f"Expected alignment error: {at_least(report.chosen.alignment_px, 'px')} new"
        words += f", {at_least(record.quality.alignment_px, 'px')} present." if record is not None else "."
        words += f" {compared.sentence}" if compared is not None else ""
        self._dialogs.ask(
            "Replace the alignment",
            _WORSE,
            f"{words} Click the pairs with the largest residuals again, or add pairs.",
            "Replace anyway",
            partial(self._save, report),
        )

    def _save(self, report: CalibrationReport) -> None:
        """Put the alignment and its record into the document, as one undoable step, and save the file."""
        with self.messages.telling("saved"):
            if self._document.edit_many(report_changes(report, self._document.preset, self.session.state.snapshots)):
                self._saved = True
                self._save_file()

    def _save_file(self) -> None:
        self._context.saveRequested.emit()
        if self._document.dirty:  # a new preset needs a file name first
            self.messages.show_message(
                "saved",
                Severity.WARNING,
                "The alignment is in the preset, but the preset's file is not saved yet. Undo in the main window "
                "removes the alignment.",
                offers=[("Save preset", self._save_file)],
            )

    def _file_changed(self) -> None:
        if self._saved and not self._document.dirty:
            self.messages.show_message("saved", Severity.INFO, f"The preset was saved in {self._document.path}.")

    def _refused(self, _: str, words: str) -> None:
        if self.isVisible():
            self.messages.show_message("saved", Severity.ERROR, words)

    # Events

    def keyPressEvent(self, event: QKeyEvent | None) -> None:
        """Pass Escape and Enter to the pages: neither closes the wizard."""
        if event is not None and event.key() in {Qt.Key.Key_Escape, Qt.Key.Key_Return, Qt.Key.Key_Enter}:
            event.accept()
            return
        super().keyPressEvent(event)

    def closeEvent(self, event: QCloseEvent | None) -> None:
        self.frames.step.close_down()
        for job in (self.fitter.job, self.points.finder.job, self.quality.job, self.check.job):
            job.stop()
        self.keeper.close()
        self.session.close()
        super().closeEvent(event)


def _short(report: CalibrationReport) -> str:
    """Return the verdict in one line: grade and errors; the page Quality says why and what to do next."""
    quality = report.chosen
    if quality.rms_px is None:
        return report.verdict
    word = grade(quality).partition(":")[0]
    errors = f"{at_least(quality.alignment_px, 'px')}, {at_least(quality.alignment_mm, 'mm')}"
    return f"{word}, {report.model}: {errors}."


_NO_FRAME = "There is no frame to calibrate on yet: open a source first."


class CalibrationLauncher(QObject):
    """Opens at most one wizard."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._context = context
        self.wizard: CalibrationWizard | None = None

    def open_wizard(self) -> None:
        context = self._context
        if context.result is None:
            context.messages.show_message("calibration", Severity.WARNING, _NO_FRAME, subject=SOURCE)
            return
        context.messages.clear_subject(TASK)
        if self.wizard is None:
            self.wizard = CalibrationWizard(context, context.result.source.rig)
            self.wizard.finished.connect(self._wizard_closed)
        bring_up(self.wizard)

    def close(self) -> None:
        if self.wizard is not None:
            self.wizard.close()

    def _wizard_closed(self) -> None:
        if self.wizard is not None:
            self.wizard.deleteLater()
        self.wizard = None
