"""The page for taking snapshots: averages of live, frozen or recorded frames."""

from __future__ import annotations

import math

from PyQt6.QtCore import QSize, Qt, QTimer
from PyQt6.QtGui import QIcon, QImage, QPixmap
from PyQt6.QtWidgets import (
    QGridLayout,
    QHBoxLayout,
    QLabel,
    QListWidget,
    QListWidgetItem,
    QSlider,
    QWidget,
)

from ...core.model.alignment import Side
from ...core.model.clouds import valid_depth
from ...core.model.frames import Rig, SensorFrame
from ...widgets.basics.controls import ProgressBar, caption, frame_count, push_button, wrapped_label
from ...widgets.basics.gestures import GestureClock
from ...widgets.basics.layouts import hbox, vbox
from ...widgets.images.image_pane import ImagePane
from ..worker.feed import FrameFeed
from .pictures import image_choices, picture
from .session import ImageChoice, Session, SessionState, Snapshot
from .snapshots import MAX_FRAMES, MOVED_LIMIT_M, Collector

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
        self._gestures = GestureClock()
        self._redraw = QTimer(self)
        self._redraw.setSingleShot(True)
        self._redraw.setInterval(_PREVIEW_MS)
        self._make_controls()
        self._lay_out()
        self._connect()
        self.setFocusProxy(self.take)
        self._show_state(session.state)
        self._show_frame()

    def _make_controls(self) -> None:
        self.source = QLabel()
        self.play = push_button("Play", "Play the source, or pause it at this frame")
        self.seek = QSlider(Qt.Orientation.Horizontal)
        self.seek.setAccessibleName("Frame of the recording")
        self.seek.setToolTip("Frame of the recording")
        self.average = frame_count(
            MAX_FRAMES,
            "Number of frames to average, starting with the current one: the median of each pixel over its valid "
            "depths. More frames, less noise; the membrane must not move meanwhile",
        )
        self.take = push_button(
            "Take snapshot", "Average the next frames and add them as a snapshot (Ctrl+T)", shortcut="Ctrl+T"
        )
        self.cancel = push_button("Cancel", "Cancel the snapshot")
        self.progress = ProgressBar()
        self.note = wrapped_label()
        self.list = QListWidget()
        self.list.setIconSize(_THUMBNAIL)
        self.list.setAccessibleName("Snapshots")
        self.list.setToolTip("The snapshots taken; points are clicked in the selected one")
        self.list.setSpacing(4)
        self.remove = push_button("Remove", "Remove the snapshot and the points clicked in it; undo restores both")
        self.span = wrapped_label()

    def _lay_out(self) -> None:
        images = QGridLayout()
        images.setSpacing(4)
        for number, pane in enumerate(self.previews.values()):
            pane.view.setMinimumSize(160, 100)
            images.addWidget(pane, number // 2, number % 2)
        transport = hbox(self.play, (self.seek, 1), self.source)
        taking = QHBoxLayout()
        self.average.setFixedWidth(110)
        taking.addWidget(caption("A&verage", self.average))
        taking.addWidget(self.average)
        taking.addWidget(self.progress, 1)
        taking.addWidget(self.cancel)
        taking.addStretch(0)
        self.note.setMinimumHeight(2 * self.fontMetrics().height() + 4)
        self.note.setAlignment(Qt.AlignmentFlag.AlignTop)
        left = vbox((images, 1), transport, taking, self.note)
        box = QWidget()
        vbox(QLabel("Snapshots"), (self.list, 1), self.span, self.remove, within=box, margins=0)
        box.setFixedWidth(300)
        hbox((left, 1), box, within=self, margins=(8, 8, 8, 4))

    def _connect(self) -> None:
        feed, collector, session = self._feed, self._collector, self._session
        feed.frameArrived.connect(self._frame_arrived)
        feed.playbackChanged.connect(self._show_playback)
        self._redraw.timeout.connect(self._show_frame)
        self.play.clicked.connect(self._play_or_hold)
        self.seek.sliderMoved.connect(feed.seek)
        self.seek.actionTriggered.connect(lambda _: feed.seek(self.seek.sliderPosition()))
        self.average.valueChanged.connect(
            lambda count: session.choose("Frames to average", self._gestures.number(), average=count)
        )
        self.take.clicked.connect(self.start)
        self.cancel.clicked.connect(collector.cancel)
        collector.progress.connect(self._show_progress)
        collector.taken.connect(self._taken)
        collector.failed.connect(self._failed)
        session.changed.connect(self._show_state)
        self.list.currentItemChanged.connect(self._chosen)
        self.remove.clicked.connect(self._remove)

    def start(self) -> None:
        """Take a snapshot of the current frame and the following ones."""
        self._collector.start(self.average.value())
        self._show_busy()

    # Display

    def _frame_arrived(self, _: SensorFrame) -> None:
        if self.isVisible() and not self._redraw.isActive():
            self._redraw.start()

    def _show_frame(self) -> None:
        self._show_playback()
        frame, info = self._feed.frame, self._feed.info
        for (side, image), pane in self.previews.items():
            if image not in image_choices(frame, side):
                pane.set_pixels(None, (640, 480), 1)
                pane.set_message("This camera has no colour image")
                continue
            shown = picture(frame, info.rig, side, image, stretch=True)
            height, width = shown.gray.shape
            pane.set_message("")
            pane.set_pixels(shown.pixels, (width, height), 1)
            pane.show_rect(pane.image_rect())
        self._show_busy()

    def _show_playback(self) -> None:
        playback, info = self._feed.playback, self._feed.info
        moving = playback.playing and not playback.frozen
        self.play.setText("Hold" if moving else "Play")
        self.play.setEnabled(info.length != 1)
        self.seek.setVisible(info.length is not None and info.length > 1)
        if info.length is not None:
            self.seek.setMaximum(info.length - 1)
            if not self.seek.isSliderDown():
                self.seek.setValue(playback.index)
            self.source.setText(f"recorded, frame {playback.index + 1} of {info.length}")
        else:
            self.source.setText("live" if moving else "live, held")

    def _show_state(self, state: SessionState) -> None:
        self.average.blockSignals(True)
        self.average.setValue(state.choices.average)
        self.average.blockSignals(False)
        digests = [snapshot.digest for snapshot in state.snapshots]
        if digests != [self.list.item(row).data(Qt.ItemDataRole.UserRole) for row in range(self.list.count())]:  # type: ignore[union-attr]
            if len(digests) < self.list.count():
                self.note.clear()  # it speaks of a snapshot that is gone
            self.list.blockSignals(True)
            self.list.clear()
            for snapshot in state.snapshots:
                self.list.addItem(self._item(snapshot))
            self.list.blockSignals(False)
        self.list.blockSignals(True)
        self.list.setCurrentRow(digests.index(state.choices.snapshot) if state.choices.snapshot in digests else -1)
        self.list.blockSignals(False)
        self.remove.setEnabled(bool(digests))
        self.span.setText(span_words(state, self._session.rig))
        if not self._collector.busy and not self.note.text():
            self.note.setText(_ADVICE)

    def _item(self, snapshot: Snapshot) -> QListWidgetItem:
        shown = picture(snapshot.frame, self._session.rig, "proximity", "color", stretch=True)
        height, width = shown.gray.shape
        image = QImage(shown.pixels.tobytes(), width, height, 4 * width, QImage.Format.Format_RGB32)
        thumbnail = image.scaled(
            _THUMBNAIL, Qt.AspectRatioMode.KeepAspectRatio, Qt.TransformationMode.SmoothTransformation
        )
        depth = apex_m(snapshot.frame, self._session.rig)
        words = f"{snapshot.name}\nmembrane at {1e3 * depth:.0f} mm"
        if snapshot.source not in {"", self._feed.info.name}:
            words += f"\n{snapshot.source}"
        item = QListWidgetItem(QIcon(QPixmap.fromImage(thumbnail)), words)
        item.setData(Qt.ItemDataRole.UserRole, snapshot.digest)
        item.setToolTip(
            f"{snapshot.averaged} frames averaged of {snapshot.source or 'an unknown source'}; SHA-256 "
            f"{snapshot.digest[:16]}…"
        )
        return item

    def _show_progress(self, share: float, words: str) -> None:
        self.progress.show_share(share, words)
        self._show_busy()

    def _show_busy(self) -> None:
        busy = self._collector.busy
        self.progress.setVisible(busy)
        self.cancel.setVisible(busy)
        self.take.setEnabled(not busy)
        self.average.setEnabled(not busy)

    def _taken(self, snapshot: Snapshot) -> None:
        if snapshot.moved_m > MOVED_LIMIT_M:
            self.note.setText(
                f"The membrane moved by {1e3 * snapshot.moved_m:.1f} mm while {snapshot.averaged} frames were "
                "averaged, so dots are blurred. Hold it still and take the snapshot again, or average fewer frames."
            )
        else:
            words = "Snapshot taken."
            if snapshot.averaged < self._collector.asked:
                end = "the membrane moves after them" if self._collector.moved_on else "the source has no more"
                words = f"{snapshot.averaged} of {self._collector.asked} frames: {end}."
                if not self._collector.moved_on and self._feed.info.length != 1:
                    words += " For more, go back in the recording and take the snapshot again."
            self.note.setText(f"{words} {_NEXT}")
        self._session.add_snapshot(snapshot)
        self._show_busy()

    def _failed(self, sentence: str) -> None:
        self.note.setText(sentence or "Cancelled; no snapshot was taken.")
        self._show_busy()

    # Actions

    def _play_or_hold(self) -> None:
        playback = self._feed.playback
        if playback.playing and not playback.frozen:
            self._feed.pause()
            self.play.setText("Play")
        else:
            self._feed.play()

    def _chosen(self, item: QListWidgetItem | None, _: QListWidgetItem | None = None) -> None:
        if item is not None:
            self._session.set_display(snapshot=item.data(Qt.ItemDataRole.UserRole))

    def _remove(self) -> None:
        item = self.list.currentItem()
        if item is not None:
            self._session.remove_snapshot(item.data(Qt.ItemDataRole.UserRole))


def apex_m(frame: SensorFrame, rig: Rig) -> float:
    """Return the median tactile depth at the image centre, metres; nan without depth."""
    height, width = frame.tactile_depth.shape
    centre = frame.tactile_depth[height // 3 : 2 * height // 3, width // 3 : 2 * width // 3]
    counts = sorted(centre[valid_depth(centre)])
    return float(counts[len(counts) // 2]) * rig.tactile.depth_unit_m if counts else float("nan")


def span_words(state: SessionState, rig: Rig) -> str:
    """Describe the depth range that the snapshots span."""
    depths = [apex_m(snapshot.frame, rig) for snapshot in state.snapshots]
    depths = [depth for depth in depths if math.isfinite(depth)]
    if not depths:
        return (
            "None yet. One is enough to start; two or three inflation levels make the alignment accurate at every "
            "depth."
        )
    span = 1e3 * (max(depths) - min(depths))
    if len(depths) == 1:
        return "One snapshot. Another inflation level would span depth."
    return f"{len(depths)} snapshots; the membrane's centre spans {span:.0f} mm of depth."
