"""The findings on the present frame: in the status bar, beside controls, in the empty patch view and in a list."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from PyQt6.QtCore import QObject, Qt, QTimer
from PyQt6.QtGui import QAction, QPalette
from PyQt6.QtWidgets import QDialog, QFrame, QLabel, QToolButton, QVBoxLayout, QWidget

from ...core.preset import Preset
from ...core.tuning.advice.proposal import Finding
from ...widgets.basics.controls import NoteLabel, push_button
from ...widgets.basics.dialogs import bring_up
from ...widgets.basics.layouts import STRETCH, hbox, scrolling, vbox
from ...widgets.parameters.form import ShownFinding
from ...widgets.parameters.parameter_panel import ParameterPanel
from ..context import Context
from ..worker.results import CloudName
from .actions import Actions, plain_text
from .status import FrameStatus
from .view_area import ViewArea

#: A finding that is gone stays on the screen for this long, milliseconds: it may come back with the next frame.
LINGER_MS = 1000

_NOTHING = "Nothing is wrong with this frame."
_NO_FRAME = "No frame was examined yet: open a source (Ctrl+O)."


class FindingsWindow(QDialog):
    """Lists the findings with their evidence; ``mend`` is called with the finding whose button was pressed."""

    def __init__(self, mend: Callable[[Finding], None], undo: QAction, parent: QWidget) -> None:
        super().__init__(parent)
        self.setWindowTitle("Findings – Tactune")
        self._mend = mend
        self.addAction(undo)
        self._cards = QVBoxLayout()
        self._cards.setSpacing(8)
        content = QWidget()
        vbox(self._cards, STRETCH, within=content, margins=4)
        undo_button = QToolButton()
        undo_button.setDefaultAction(undo)
        undo_button.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        leave = push_button("Close", "Close this list (Esc)")
        leave.clicked.connect(self.reject)
        vbox((scrolling(content), 1), hbox(undo_button, STRETCH, leave), within=self)
        self.resize(480, 460)

    def show_findings(self, findings: Sequence[tuple[Finding, ShownFinding]], examined: bool) -> None:
        while (item := self._cards.takeAt(0)) is not None:
            widget = item.widget()
            if widget is not None:
                widget.hide()
                widget.deleteLater()
        cards: list[QWidget] = [self._card(finding, shown) for finding, shown in findings]
        for card in cards or [QLabel(_NOTHING if examined else _NO_FRAME)]:
            self._cards.addWidget(card)
            card.show()  # at once, so that the list is never painted empty

    def _card(self, finding: Finding, shown: ShownFinding) -> QWidget:
        card = QFrame()
        card.setFrameShape(QFrame.Shape.StyledPanel)
        column = QVBoxLayout(card)
        said = NoteLabel(finding.sentence)
        font = said.font()
        font.setBold(True)
        said.setFont(font)
        column.addWidget(said)
        proposal = finding.proposal
        if proposal is not None:
            if proposal.evidence != finding.sentence:
                column.addWidget(NoteLabel(proposal.evidence))
            expected = NoteLabel(proposal.expected)
            expected.setForegroundRole(QPalette.ColorRole.PlaceholderText)
            column.addWidget(expected)
        if shown.button:
            button = push_button(shown.button, shown.tip)
            button.clicked.connect(lambda: self._mend(finding))
            column.addLayout(hbox(button, STRETCH))
        return card


class FindingsControl(QObject):
    """Keeps the findings that are shown and applies their remedies; one that comes and goes stays."""

    def __init__(
        self, context: Context, actions: Actions, *, panel: ParameterPanel, views: ViewArea, status: FrameStatus
    ) -> None:
        super().__init__(context)
        self._context, self._actions = context, actions
        self._panel, self._status = panel, status
        self._view = views.views[CloudName.PATCH]
        self._shown: dict[str, Finding] = {}
        self._present: dict[str, Finding] = {}
        self._preset: Preset | None = None
        self._offered: Finding | None = None
        self._window: FindingsWindow | None = None
        self._timer = QTimer(self)
        self._timer.setSingleShot(True)
        self._timer.setInterval(LINGER_MS)
        self._timer.timeout.connect(self._drop_gone)
        context.worker.examined.connect(self._found)
        context.worker.opened.connect(lambda _: self._forget())
        context.frameShown.connect(self._explain_empty)
        panel.remedyPressed.connect(self._mend_field)
        self._view.offerPressed.connect(lambda: self.mend(self._offered) if self._offered is not None else None)
        status.findings.clicked.connect(self.open)

    def open(self) -> None:
        if self._window is None:
            self._window = FindingsWindow(self.mend, self._actions.undo, self._context.window)
        self._show()
        bring_up(self._window)

    def _in_words(self, finding: Finding) -> ShownFinding:
        """Return a finding with text and tooltip of the button that mends it."""
        proposal, action = finding.proposal, self._action(finding.action)
        if proposal is not None:
            tip = f"{proposal.evidence}\n{proposal.expected}\nCtrl+Z undoes it."
            return ShownFinding(finding.sentence, proposal.label, tip)
        if action is None:
            return ShownFinding(finding.sentence)
        return ShownFinding(finding.sentence, plain_text(action), action.toolTip())

    def mend(self, finding: Finding) -> None:
        """Apply the proposal of a finding as one undo step, or trigger its action."""
        action = self._action(finding.action)
        if finding.proposal is None:
            if action is not None:
                action.trigger()
        elif self._context.document.apply(finding.proposal):
            self._shown.pop(finding.name, None)  # the next examination shows whether it helped
            self._present.pop(finding.name, None)
            self._show()

    def _mend_field(self, path: str) -> None:
        finding = next((finding for finding in self._shown.values() if finding.field == path), None)
        if finding is not None:
            self.mend(finding)

    def _action(self, name: str) -> QAction | None:
        return getattr(self._actions, name) if name else None

    def _found(self, findings: tuple[Finding, ...], preset: Preset) -> None:
        if preset is not self._context.document.preset:
            return  # edited meanwhile; the next examination follows
        before, first = self._shown, self._preset is None
        self._preset, self._present = preset, {finding.name: finding for finding in findings}
        gone = {name: finding for name, finding in before.items() if name not in self._present}
        self._shown = self._present | gone
        if gone and not self._timer.isActive():
            self._timer.start()
        if first or self._shown != before:
            self._show()

    def _drop_gone(self) -> None:
        self._shown = dict(self._present)
        self._show()

    def _forget(self) -> None:
        self._shown, self._present, self._preset = {}, {}, None
        self._show()

    def _show(self) -> None:
        findings = [(finding, self._in_words(finding)) for finding in self._shown.values()]
        rows: dict[str, ShownFinding] = {}
        for finding, shown in findings:  # the first of a field: causes come before consequences
            rows.setdefault(finding.field, shown)
        self._panel.show_findings(rows)
        self._status.show_findings(len(findings))
        if self._window is not None:
            self._window.show_findings(findings, examined=self._preset is not None)
        self._explain_empty()

    def _explain_empty(self) -> None:
        """Show below the message of an empty patch view what mends it, and the finding that explains it."""
        result = self._context.result
        self._offered = None
        if result is None or result.compared is not None or (result.patch is not None and len(result.patch.points)):
            self._view.set_offer("")
            return
        explaining = next((finding for finding in self._shown.values() if finding.explains_empty), None)
        if explaining is not None:
            self._view.set_message(explaining.sentence)
            self._context.messages.clear("problem")  # it says the same, without a remedy
            self._offered = explaining
        elif result.rendered.no_contact_action:
            rendered = result.rendered
            self._offered = Finding("no_contact", "", rendered.no_contact, action=rendered.no_contact_action)
        offer = ShownFinding("") if self._offered is None else self._in_words(self._offered)
        self._view.set_offer(offer.button, offer.tip)
