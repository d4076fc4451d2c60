"""The page for taking snapshots: averages of live, frozen or recorded frames."""

from __future__ import annotations

import numpy as np
from PyQt6.QtCore import QSignalBlocker, QSize, Qt, QTimer
from PyQt6.QtGui import QIcon, QImage, QPixmap
from PyQt6.QtWidgets import QGridLayout, QLabel, QListWidget, QListWidgetItem, QSlider, QWidget

from ...core.model.alignment import Side
from ...core.model.clouds import valid_depth
from ...core.model.frames import SensorFrame
from ...widgets.basics.controls import push_button, wrapped_label
from ...widgets.basics.layouts import hbox, vbox
from ...widgets.images.image_pane import ImagePane
from ..worker.worker import FrameFeed
from .pictures import picture
from .session import ImageChoice, Session, SessionState, Snapshot
from .snapshots import FRAMES, Collector

_PREVIEW_MS = 80
_THUMBNAIL = QSize(96, 72)

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
_NEXT = "Add another inflation level, or continue with the points."


class FramesPage(QWidget):
    """A live preview of both cameras beside the list of snapshots. The wizard places the button ``take``."""

    def __init__(self, session: Session, feed: FrameFeed, collector: Collector) -> None:
        super().__init__()
        self._session, self._feed, self._collector = session, feed, collector
        self.previews = {(side, image): ImagePane(title) for side, image, title in _PREVIEWS}
        self._listed: tuple[str, ...] = ()
        self._redraw = QTimer(self)
        self._redraw.setSingleShot(True)
        self._redraw.setInterval(_PREVIEW_MS)
        self.seek = QSlider(Qt.Orientation.Horizontal)
        self.seek.setAccessibleName("Frame of the recording")
        self.seek.setToolTip("Frame of the recording")
        self.take = push_button(
            "Take snapshot",
            f"Average {FRAMES} frames, or as many as show the membrane standing still, and add them as a snapshot "
            "(Ctrl+T)",
            shortcut="Ctrl+T",
        )
        self.note = wrapped_label(_ADVICE)
        self.note.setMinimumHeight(2 * self.fontMetrics().height() + 4)
        self.note.setAlignment(Qt.AlignmentFlag.AlignTop)
        self.list = QListWidget()
        self.list.setIconSize(_THUMBNAIL)
        self.list.setAccessibleName("Snapshots")
        self.list.setToolTip("The snapshots taken; points are clicked in the selected one")
        self.list.setSpacing(4)
        self.remove = push_button("Remove", "Remove the snapshot and the points clicked in it; undo restores both")
        self._lay_out()
        self._connect()
        self.setFocusProxy(self.take)
        self._show_state(session.state)
        self._show_frame()

    def _lay_out(self) -> None:
        images = QGridLayout()
        images.setSpacing(4)
        for number, pane in enumerate(self.previews.values()):
            pane.view.setMinimumSize(160, 100)
            images.addWidget(pane, number // 2, number % 2)
        left = vbox((images, 1), self.seek, self.note)
        self.taken = QWidget()
        vbox(QLabel("Snapshots"), (self.list, 1), self.remove, within=self.taken, margins=0)
        self.taken.setFixedWidth(300)
        hbox((left, 1), self.taken, within=self, margins=(8, 8, 8, 4))

    def _connect(self) -> None:
        collector, session = self._collector, self._session
        self._feed.frameArrived.connect(self._frame_arrived)
        self._redraw.timeout.connect(self._show_frame)
        self.seek.valueChanged.connect(self._feed.seek)
        self.take.clicked.connect(collector.start)
        collector.progress.connect(self.note.setText)
        collector.taken.connect(self._taken)
        collector.failed.connect(self.note.setText)
        session.changed.connect(self._show_state)
        self.list.currentRowChanged.connect(self._chosen)
        self.remove.clicked.connect(lambda: session.remove_snapshot(session.state.choices.snapshot))

    # Display

    def _frame_arrived(self, _: SensorFrame) -> None:
        if self.isVisible() and not self._redraw.isActive():
            self._redraw.start()

    def _show_frame(self) -> None:
        frame, playback = self._feed.frame, self._feed.playback
        self.seek.setVisible(playback.seekable)
        if playback.length is not None and not self.seek.isSliderDown():
            with QSignalBlocker(self.seek):
                self.seek.setMaximum(playback.length - 1)
                self.seek.setValue(playback.index)
        for (side, image), pane in self.previews.items():
            if image == "color" and side == "tactile" and frame.tactile_color is None:
                pane.set_pixels(None, (640, 480), 1)
                pane.set_message("This camera has no colour image")
                continue
            shown = picture(frame, self._feed.rig, side, image)
            height, width = shown.gray.shape
            pane.set_message("")
            pane.set_pixels(shown.pixels, (width, height), 1)
            pane.show_rect(pane.image_rect())

    def _show_state(self, state: SessionState) -> None:
        with QSignalBlocker(self.list):
            if state.digests != self._listed:
                self._listed = state.digests
                self.list.clear()
                for snapshot in state.snapshots:
                    self.list.addItem(self._item(snapshot))
            self.list.setCurrentRow(-1 if state.number is None else state.number)
        self.remove.setEnabled(state.number is not None)
        self.taken.setVisible(bool(state.snapshots))

    def _item(self, snapshot: Snapshot) -> QListWidgetItem:
        shown = picture(snapshot.frame, self._session.rig, "proximity", "color")
        height, width = shown.gray.shape
        image = QImage(shown.pixels.tobytes(), width, height, 4 * width, QImage.Format.Format_RGB32)
        thumbnail = image.scaled(
            _THUMBNAIL, Qt.AspectRatioMode.KeepAspectRatio, Qt.TransformationMode.SmoothTransformation
        )
        counts = snapshot.frame.tactile_depth
        centre = counts[
            counts.shape[0] // 3 : 2 * counts.shape[0] // 3, counts.shape[1] // 3 : 2 * counts.shape[1] // 3
        ]
        depths_m = centre[valid_depth(centre)] * self._session.rig.tactile.depth_unit_m
        words = snapshot.name + (f"\nmembrane at {1e3 * np.median(depths_m):.0f} mm" if len(depths_m) else "")
        if snapshot.source not in {"", self._feed.info.name}:
            words += f"\n{snapshot.source}"
        return QListWidgetItem(QIcon(QPixmap.fromImage(thumbnail)), words)

    def _taken(self, snapshot: Snapshot) -> None:
        words = "Snapshot taken."
        if snapshot.averaged < FRAMES:
            end = "the membrane moves after them" if self._collector.moved_on else "the source has no more"
            words = f"{snapshot.averaged} of {FRAMES} frames: {end}."
        self.note.setText(f"{words} {_NEXT}")
        self._session.add_snapshot(snapshot)

    def _chosen(self, row: int) -> None:
        if row >= 0:
            self._session.set_display(snapshot=self._listed[row])
