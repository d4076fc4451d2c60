"""The findings on the present frame and rig: in a rail of their own, at their fields, and in the empty patch view."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from PyQt6.QtCore import QObject, Qt
from PyQt6.QtGui import QAction
from PyQt6.QtWidgets import QWIDGETSIZE_MAX, QPushButton, QVBoxLayout, QWidget

from ...core.contact.alignment import UNKNOWN_POSE
from ...core.errors import as_sentence
from ...core.preset import Preset
from ...core.tuning.advice.proposal import Finding
from ...widgets.basics.controls import NoteLabel, heading, push_button, timer
from ...widgets.basics.layouts import STRETCH, empty, hbox, holding, scrolling, vbox
from ...widgets.parameters.parameter_panel import ParameterPanel
from ..context import Context
from ..worker.results import CloudName
from .actions import Actions, plain_text
from .view_area import ViewArea

#: A finding that is gone stays on the screen for this long, milliseconds: it may come back with the next frame.
LINGER_MS = 1000

#: Smallest height of the rail, pixels; in a window lower than the second, only while it has findings or a message.
RAIL_PX, LOW_PX = 112, 640

_MARGINS = 8, 4, 8, 4
_NOTHING = "Nothing is wrong with this frame."
_NO_FRAME = "No patch was examined yet."
#: A finding, and text and tooltip of the button that mends it; without a text there is none.
_Shown = tuple[Finding, str, str]


class FindingsRail(QWidget):
    """Lists the findings in a place of their own; ``mend`` is called with the one whose button was pressed."""

    def __init__(self) -> None:
        super().__init__()
        self.mend: Callable[[Finding], None] = lambda finding: None
        self.title = heading()
        self._cards = QVBoxLayout()
        self._cards.setSpacing(4)
        self._area = scrolling(holding(vbox(self._cards, STRETCH, margins=0)))
        self._column = vbox(self.title, (self._area, 1), within=self, margins=_MARGINS, spacing=4)
        self._low = self._full = False
        self.setAccessibleName("Findings")
        self.show_findings((), examined=False)

    def show_findings(self, findings: Sequence[_Shown], examined: bool) -> None:
        self.title.setText(f"Findings: {len(findings)}" if findings else "No findings" if examined else "Findings")
        self._full = bool(findings)
        self._fit()
        empty(self._cards)
        cards: list[QWidget] = [self._card(*shown) for shown in findings]
        for card in cards or [NoteLabel(_NOTHING if examined else _NO_FRAME)]:
            self._cards.addWidget(card)
            card.show()  # at once, so that the list is never painted empty

    def leave_free(self, below_px: int) -> None:
        """Let the list end above what covers the lower edge: the rest of a long finding can be scrolled to."""
        left, top, right, bottom = _MARGINS
        self._column.setContentsMargins(left, top, right, max(bottom, below_px))
        self._fit()

    def show_low(self, low: bool) -> None:
        """Leave what the words do not need to the controls above, as in a low window."""
        self._low = low
        self._fit()

    def _fit(self) -> None:
        _, top, _, bottom = _MARGINS
        words = 2 * self.fontMetrics().height() + top + 4 + bottom
        only_words = self._low and not self._full and self._column.contentsMargins().bottom() == bottom
        self.setMinimumHeight(words if only_words else RAIL_PX)
        self.setMaximumHeight(words if only_words else QWIDGETSIZE_MAX)

    def focus_first(self) -> None:
        button = next(iter(self._area.findChildren(QPushButton)), None)
        (button or self._area).setFocus(Qt.FocusReason.ShortcutFocusReason)

    def _card(self, finding: Finding, mends: str, tip: str) -> QWidget:
        card, said = QWidget(), NoteLabel(finding.sentence)
        said.tint("warning")
        column = vbox(said, within=card, margins=0, spacing=4)
        if finding.proposal is not None:
            said.setToolTip(f"{finding.proposal.evidence}\n{finding.proposal.expected}")
        if mends:
            button = push_button(mends, tip)
            button.clicked.connect(lambda: self.mend(finding))
            column.addLayout(hbox(button, STRETCH))
        return card


class FindingsControl(QObject):
    """Keeps the findings that are shown and applies their remedies; one that comes and goes stays."""

    def __init__(
        self, context: Context, actions: Actions, *, panel: ParameterPanel, views: ViewArea, rail: FindingsRail
    ) -> None:
        super().__init__(context)
        self._context, self._actions = context, actions
        self._panel, self._rail = panel, rail
        self._view = views.views[CloudName.PATCH]
        self._shown: dict[str, Finding] = {}
        self._present: dict[str, Finding] = {}
        self._warnings: tuple[str, ...] = ()  # on the rig, of the frame on the screen
        self._preset: Preset | None = None
        self._judged = False
        self._offered: Finding | None = None
        rail.mend = self.mend
        self._timer = timer(self, LINGER_MS, self._drop_gone, once=True)
        context.worker.examined.connect(self._found)
        context.worker.opened.connect(lambda _: self._forget())
        context.frameShown.connect(self._follow_frame)
        offer = self._view.notice.button
        offer.clicked.connect(lambda: self.mend(self._offered) if self._offered is not None else None)

    def _button(self, finding: Finding | None) -> tuple[str, str]:
        """Return text and tooltip of the button that mends a finding; empty texts if nothing does."""
        if finding is not None and (proposal := finding.proposal) is not None:
            return proposal.label, f"{proposal.evidence}\n{proposal.expected}\nCtrl+Z undoes it."
        action = None if finding is None else self._action(finding.action)
        return ("", "") if action is None else (plain_text(action), action.toolTip())

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

    def _action(self, name: str) -> QAction | None:
        return getattr(self._actions, name) if name else None

    def _found(self, findings: tuple[Finding, ...], preset: Preset) -> None:
        if preset is not self._context.document.preset:
            return  # edited meanwhile; the next examination follows
        before = self._shown
        self._preset, self._present = preset, {finding.name: finding for finding in findings}
        gone = {name: finding for name, finding in before.items() if name not in self._present}
        self._shown = self._present | gone
        if gone and not self._timer.isActive():
            self._timer.start()
        if not self._judged or self._shown != before:
            self._show()

    def _drop_gone(self) -> None:
        self._shown = dict(self._present)
        self._show()

    def _follow_frame(self) -> None:
        result = self._context.result
        if result is not None and result.warnings != self._warnings:
            self._warnings = result.warnings
            self._show()
        else:
            self._explain_empty()

    def _forget(self) -> None:
        self._shown, self._present, self._preset, self._warnings = {}, {}, None, ()
        self._show()

    def _show(self) -> None:
        findings = [(finding, *self._button(finding)) for finding in self._shown.values()]
        rows: dict[str, str] = {}
        for finding in self._shown.values():  # the first of a field: causes come before consequences
            rows.setdefault(finding.field, finding.sentence)
        findings += [(Finding(said, "", said), "", "") for said in self._warnings]
        self._panel.show_findings(rows)
        result = self._context.result
        self._judged = self._preset is not None and result is not None and result.patch is not None
        self._rail.show_findings(findings, examined=self._judged)
        self._explain_empty()

    def _explain_empty(self) -> None:
        """Show below the message of an empty patch view what mends it, and the finding that explains it."""
        result = self._context.result
        self._offered = None
        if result is None or result.compared is not None or (result.patch is not None and len(result.patch.points)):
            self._view.notice.offer("")
            return
        explaining = next((finding for finding in self._shown.values() if finding.explains_empty), None)
        said = result.problem or result.rendered.no_contact
        self._view.set_message(said if explaining is None else explaining.sentence)
        if explaining is not None:
            self._offered = explaining
        elif result.problem == as_sentence(UNKNOWN_POSE):
            self._offered = Finding("no_pose", "", result.problem, action="calibrate")
        elif result.rendered.no_contact_action:
            rendered = result.rendered
            self._offered = Finding("no_contact", "", rendered.no_contact, action=rendered.no_contact_action)
        self._view.notice.offer(*self._button(self._offered))
