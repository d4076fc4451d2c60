"""The window that shows suggestions for the preset, and the object that opens it."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from PyQt6.QtCore import QObject
from PyQt6.QtGui import QKeySequence, QShortcut
from PyQt6.QtWidgets import QCheckBox, QDialog, QGridLayout, QLabel, QWidget

from ...core.errors import PresetError, TactuneError, as_sentence
from ...core.preset import Preset, now
from ...core.sources.base import part_of
from ...core.tuning.advice.proposal import Evidence, Proposal
from ...core.tuning.advice.suggest import AllProposals, suggest_all
from ...widgets.basics.controls import NoteLabel, push_button, wrapped_label
from ...widgets.basics.dialogs import bring_up
from ...widgets.basics.fields import field_spec
from ...widgets.basics.layouts import STRETCH, empty, hbox, holding, scrolling, vbox
from ...widgets.basics.theme import text_font
from ...widgets.parameters.parameter_panel import SECTIONS
from ..context import Context
from ..document.comparison import Side
from ..worker.jobs import Job, JobRow, Progress
from ..worker.results import Result

_TITLES = dict(SECTIONS)


def section_title(section: str) -> str:
    return _TITLES.get(section, section.replace("_", " ").capitalize())


class ProposalCard(QWidget):
    """Shows a proposal, which can be left out."""

    def __init__(self, proposal: Proposal, preset: Preset) -> None:
        super().__init__()
        self.proposal, self._preset = proposal, preset
        self.take = QCheckBox(section_title(proposal.section))
        self.take.setToolTip(f"Take this suggestion for {section_title(proposal.section).lower()}, or leave it")
        self.take.setChecked(bool(proposal.changes))
        self.take.setEnabled(bool(proposal.changes))
        self.take.setFont(text_font("body", bold=True))
        self.label = NoteLabel(proposal.label)
        self.evidence, self.expected = NoteLabel(proposal.evidence), NoteLabel(proposal.expected)
        self._values = QGridLayout()
        self._values.setHorizontalSpacing(16)
        self._values.setVerticalSpacing(4)
        self._values.setColumnStretch(3, 1)
        head = hbox(self.take, (self.label, 1))
        vbox(head, self.evidence, self.expected, self._values, within=self, margins=(0, 0, 0, 8), spacing=4)
        self._show_values()

    @property
    def changes(self) -> Mapping[str, Any]:
        """What the proposal changes in the present preset; nothing if it is left out."""
        if not self.take.isChecked():
            return {}
        return {path: value for path, value in self.proposal.changes.items() if value != self._preset.value(path)}

    def show_preset(self, preset: Preset) -> None:
        self._preset = preset
        self._show_values()

    def _show_values(self) -> None:
        empty(self._values)
        for line, (path, value) in enumerate(self.proposal.changes.items()):
            spec = field_spec(Preset, path)
            now = self._preset.value(path)
            arrow = "unchanged" if now == value else f"→ {spec.describe(value)}"
            for place, text in enumerate((spec.title, spec.describe(now), arrow)):
                label = QLabel(text)
                label.setToolTip(spec.tooltip)
                self._values.addWidget(label, line, place)


#: Stands for every section, as in `Proposal.section`.
ALL: Final = "all"
_NO_FRAME: Final = "There is no frame to measure yet: open a source first."


def find_suggestions(
    section: str, result: Result, preset: Preset, home: Path | None, progress: Progress
) -> AllProposals:
    """Make the proposals of one section or of all; takes long."""
    untouched = None
    with suppress(TactuneError):  # it cannot be read; or the job was cancelled, which is raised again below
        untouched = result.source.find_untouched(preset, home, part_of(progress, 0, 2)).frame
    progress(0.5, "Measuring")
    evidence = Evidence(preset, result.source.rig, (result.frame,), untouched)
    return suggest_all(evidence, part_of(progress, 1, 2), None if section == ALL else (section,))


class SuggestWindow(QDialog):
    """Shows suggestions, compares them with the present preset in the views, and applies them as one undo step."""

    def __init__(self, context: Context) -> None:
        super().__init__(context.window)
        self.setWindowTitle("Suggestions")
        self._context, self._document = context, context.document
        self._section = ALL
        self._shown: Side | None = None
        self._applied = -1  # the place in the undo stack, until something else was done
        self.job = Job(self, self._show_found, lambda sentence: self._say(as_sentence(sentence)) if sentence else None)
        self.cards: list[ProposalCard] = []
        self.working = JobRow(self.job)
        self.sentence = wrapped_label()
        self.sentence.hide()
        self.again = push_button("&Measure again", "Make new suggestions from the present frame and preset")
        self.compare = QCheckBox("Com&pare")
        self.compare.setToolTip("Compare the present preset with the suggested one in the views")
        self.apply = push_button(
            "&Apply", "Put the ticked suggestions into the preset, as one undo step (Ctrl+Return)", "Ctrl+Return"
        )
        self.apply.setDefault(True)
        self.undo = push_button("&Undo", "Take the applied suggestions back (Ctrl+Z)", "Ctrl+Z")
        self.leave = push_button("&Close", "Close this window; the preset stays as it is (Esc)")
        self._parts = vbox()
        content = holding(vbox(self._parts, STRETCH, margins=0))
        tools = hbox(self.again, (self.working, 1))
        row = hbox(self.compare, self.undo, STRETCH, self.apply, self.leave)
        vbox(self.sentence, (scrolling(content), 1), tools, row, within=self)
        self.resize(500, 640)
        self.job.busyChanged.connect(self._show_busy)
        self.working.cancel.clicked.connect(lambda: self._say("Cancelled; nothing was changed."))
        self.again.clicked.connect(lambda: self.ask(self._section))
        self.compare.toggled.connect(self._show_comparison)
        self.apply.clicked.connect(self._apply)
        self.undo.clicked.connect(self._document.undo_stack.undo)
        self.leave.clicked.connect(self.reject)
        self._document.presetChanged.connect(self._preset_changed)
        self._document.undo_stack.indexChanged.connect(self._show_state)
        self._context.comparison.changed.connect(self._comparison_changed)
        self._context.worker.opened.connect(self._source_opened)

    def ask(self, section: str) -> None:
        """Make suggestions for a section, or for `ALL`."""
        result, document = self._context.result, self._document
        if result is None:
            self._say(_NO_FRAME)
            return
        preset, home = document.preset, document.untouched_home
        self._section = section
        self.job.cancel()
        self._clear()
        self._say("")
        self.job.start(lambda progress: find_suggestions(section, result, preset, home, progress))
        self.job.progress.emit(0.0, "Gathering evidence")

    def _source_opened(self) -> None:
        """Drop suggestions that are still being made; those that are shown should be made again."""
        if self.job.busy or self.cards:
            self.job.cancel()
            self._say("Another source was opened: measure again.")

    @property
    def proposal(self) -> Proposal:
        """The ticked suggestions as one proposal; without changes if nothing is ticked."""
        taken = [card for card in self.cards if card.changes]
        changes = {path: value for card in taken for path, value in card.changes.items()}
        if len(taken) == 1:
            return replace(taken[0].proposal, changes=changes)
        names = ", ".join(section_title(card.proposal.section).lower() for card in taken)
        return Proposal(ALL, changes, f"Suggested {names}", "", "")

    def done(self, result: int) -> None:
        self.job.cancel()
        super().done(result)
        self._show_comparison()

    def close_down(self) -> None:
        self._document.undo_stack.indexChanged.disconnect(self._show_state)
        self.reject()
        self.job.stop()

    # What was found

    def _show_found(self, found: AllProposals) -> None:
        self._say("")
        self._clear()
        for part in found.parts:
            card = ProposalCard(part, self._document.preset)
            card.take.toggled.connect(self._choice_changed)
            self.cards.append(card)
            self._parts.addWidget(card)
        for section, sentence in found.refusals.items():
            why = as_sentence(sentence.removeprefix(f"{section}: "))
            refusal = wrapped_label(f"{section_title(section)}: no suggestion. {why}", selectable=True)
            self._parts.addWidget(refusal)
        if found.parts and not any(card.changes for card in self.cards):
            self._say("The present values already follow from the evidence.")
        self.compare.setChecked(True)
        self._choice_changed()

    def _show_busy(self, busy: bool) -> None:
        self.again.setEnabled(not busy)
        self._show_state()

    def _say(self, sentence: str) -> None:
        self.sentence.setText(sentence)
        self.sentence.setVisible(bool(sentence))

    def _clear(self) -> None:
        self.cards.clear()
        self._show_comparison()
        empty(self._parts)

    # Choices

    def _preset_changed(self, preset: Preset) -> None:
        for card in self.cards:
            card.show_preset(preset)
        self._choice_changed()

    def _choice_changed(self) -> None:
        self._show_state()
        self._show_comparison()

    def _show_state(self) -> None:
        changes = bool(self.proposal.changes)
        self.apply.setEnabled(changes)
        self.compare.setEnabled(changes)
        if self._document.undo_stack.index() != self._applied:
            self._applied = -1
        self.undo.setEnabled(self._applied > 0)

    def _apply(self) -> None:
        proposal = self.proposal
        if self._section == ALL:
            proposal = replace(proposal, changes={**proposal.changes, "suggested": now()})
        if self._document.apply(proposal):
            self._applied = self._document.undo_stack.index()
            self._show_state()
            self._say(
                f"Applied: {proposal.label}. The sentences below speak of the values before; Measure again judges the "
                "new ones. Ctrl+S saves the preset; Ctrl+Z takes the step back."
            )

    # Comparison in the views

    def _show_comparison(self) -> None:
        """Compare the present preset with the suggested one, where that is wanted and they differ."""
        comparison, proposal, present = self._context.comparison, self.proposal, self._document.preset
        mine, self._shown = comparison.shows(self._shown), None
        if self.isVisible() and self.compare.isChecked() and proposal.changes:
            try:
                self._shown = Side("Suggested", proposal.apply(present))
            except PresetError as error:
                self._say(f"The suggested values do not fit together: {error}")
            else:
                comparison.show(comparison.present, self._shown)
        elif mine:
            comparison.end()

    def _comparison_changed(self) -> None:
        """Note that someone else ended or replaced the comparison."""
        if self._shown is not None and not self._context.comparison.shows(self._shown):
            self._shown = None
            self.compare.setChecked(False)


class SuggestControl(QObject):
    """Opens at most one window with suggestions."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._context = context
        self.window: SuggestWindow | None = None

    def open(self, section: str) -> None:
        context = self._context
        if self.window is None:
            self.window = SuggestWindow(context)
            QShortcut(QKeySequence.StandardKey.Save, self.window).activated.connect(context.saveRequested)
            corner = context.window.mapToGlobal(context.window.rect().topLeft())
            self.window.move(corner.x() + 8, corner.y() + 110)  # the patch view and the panel stay visible
        bring_up(self.window)
        self.window.ask(section)

    def close(self) -> None:
        if self.window is not None:
            self.window.close_down()
