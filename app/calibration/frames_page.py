"""The page for taking snapshots: averages of live, frozen or recorded frames."""

from __future__ import annotations

import numpy as np
from PyQt6.QtCore import QSignalBlocker, Qt
from PyQt6.QtWidgets import QGridLayout, QLabel, QListWidget, QWidget

from ...core.model.alignment import Side
from ...core.model.clouds import valid_depth
from ...widgets.basics.controls import keep_place, named, push_button, timer
from ...widgets.basics.layouts import hbox, holding, vbox
from ...widgets.images.image_pane import ImagePane
from ..context import Context
from .pictures import picture
from .session import ImageChoice, Session, SessionState, Snapshot
from .snapshots import SnapshotStep

_PREVIEW_MS = 80

_PREVIEWS: tuple[tuple[Side, ImageChoice, str], ...] = (
    ("proximity", "color", "Proximity camera, colour"),
    ("tactile", "color", "Tactile camera, colour"),
    ("proximity", "depth", "Proximity camera, depth"),
    ("tactile", "depth", "Tactile camera, depth"),
)
_ADVICE = (
    "Hold the membrane still and take a snapshot. Then change the inflation, or press deeper, and take another: "
    "two or three levels span depth, which a rigid alignment needs."
)


class FramesPage(QWidget):
    """A live preview of both cameras beside the list of snapshots. The wizard places the button ``take``."""

    def __init__(self, session: Session, context: Context) -> None:
        super().__init__()
        self._session, self._context = session, context
        self.step = SnapshotStep(context, session.rig)
        self.step.setParent(self)
        self.step.hide()
        self.take, self.note = self.step.start, self.step.sentence
        self.previews = {(side, image): ImagePane(title) for side, image, title in _PREVIEWS}
        self._listed: tuple[str, ...] = ()
        self._looked_at: Snapshot | None = None  # in place of the newest frame
        self._redraw = timer(self, _PREVIEW_MS, self._show_frame, once=True)
        self.note.setText(_ADVICE)
        self.note.setMinimumHeight(2 * self.fontMetrics().height() + 4)
        self.note.setAlignment(Qt.AlignmentFlag.AlignTop)
        self.list = named(QListWidget(), "Snapshots", "Click one to see it; points are clicked in the selected one")
        self.list.setSpacing(4)
        self.remove = push_button("Re&move", "Remove the snapshot and the points clicked in it; undo restores both")
        images = QGridLayout()
        images.setSpacing(4)
        for number, pane in enumerate(self.previews.values()):
            pane.view.setMinimumSize(160, 100)
            images.addWidget(pane, number // 2, number % 2)
        self.running = holding(hbox((self.step.progress, 1), self.step.cancel, margins=0))
        keep_place(self.running)
        self.running.hide()
        left = vbox((images, 1), self.note, self.running)
        self.taken = holding(vbox(QLabel("Snapshots"), (self.list, 1), self.remove, margins=0))
        self.taken.setFixedWidth(300)
        hbox((left, 1), self.taken, within=self, margins=(8, 8, 8, 4))
        step = self.step
        context.frameShown.connect(self._frame_shown)
        step.start.pressed.connect(lambda: self._look_at(None))
        step.start.clicked.connect(lambda: self.running.setVisible(step.busy))
        step.ended.connect(self._ended)
        session.changed.connect(self._show_state)
        self.list.currentRowChanged.connect(self._chosen)
        self.list.itemClicked.connect(lambda _: self._look_at(session.state.snapshot))
        self.remove.clicked.connect(lambda: session.remove_snapshot(session.state.choices.snapshot))
        self.setFocusProxy(self.take)
        self._show_state(session.state)
        self._show_frame()

    # Display

    def _frame_shown(self) -> None:
        if self.isVisible() and not self._redraw.isActive():
            self._redraw.start()

    def _show_frame(self) -> None:
        result, rig = self._context.result, self._session.rig
        if self._looked_at is not None:
            frame = self._looked_at.frame
        elif result is not None and result.source.rig == rig:
            frame = result.frame
        else:
            return
        for (side, image), pane in self.previews.items():
            if image == "color" and side == "tactile" and frame.tactile_color is None:
                pane.set_pixels(None, (640, 480), 1)
                pane.notice.set_text("This camera has no colour image")
                continue
            shown = picture(frame, rig, side, image)
            height, width = shown.gray.shape
            pane.notice.set_text("")
            pane.set_pixels(shown.pixels, (width, height), 1)
            pane.show_rect(pane.image_rect())

    def _show_state(self, state: SessionState) -> None:
        with QSignalBlocker(self.list):
            if state.digests != self._listed:
                self._listed = state.digests
                self._look_at(None)
                self.list.clear()
                self.list.addItems(map(self._words, state.snapshots))
            self.list.setCurrentRow(-1 if state.number is None else state.number)
        self.remove.setEnabled(state.number is not None)
        self.taken.setVisible(bool(state.snapshots))

    def _words(self, snapshot: Snapshot) -> str:
        counts = snapshot.frame.tactile_depth
        centre = counts[
            counts.shape[0] // 3 : 2 * counts.shape[0] // 3, counts.shape[1] // 3 : 2 * counts.shape[1] // 3
        ]
        depths_m = centre[valid_depth(centre)] * self._session.rig.tactile.depth_unit_m
        words = snapshot.name + (f"\nmembrane at {1e3 * np.median(depths_m):.0f} mm" if len(depths_m) else "")
        if snapshot.source not in {"", self._context.source_name}:
            words += f"\n{snapshot.source}"
        return words

    def _look_at(self, snapshot: Snapshot | None) -> None:
        """Show a snapshot, or the newest frame: without one, or when the one that is shown is clicked again."""
        before, self._looked_at = self._looked_at, None if snapshot is self._looked_at else snapshot
        if self._looked_at is not None:
            self.note.setText(f"{self._looked_at.name}, as taken. Click it again to see the newest frame.")
        elif before is not None:
            self.note.setText(_ADVICE)
        self._show_frame()

    def _ended(self, taken: bool) -> None:
        self.running.hide()
        if taken:
            self._session.add_snapshot(self.step.found)

    def _chosen(self, row: int) -> None:
        if row >= 0:
            self._session.set_display(snapshot=self._listed[row])
