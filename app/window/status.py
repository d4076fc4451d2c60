"""The status bar: state, source, frame rate and patch area; a panel with the other numbers."""

from __future__ import annotations

import math
import time

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QLabel, QPushButton, QStatusBar

from ...core.errors import counted, minus
from ...widgets.basics.controls import ElidedLabel, number_label
from ...widgets.basics.icons import icon
from ...widgets.basics.layouts import vbox
from ...widgets.basics.messages import Card
from ..worker.playback import PlaybackState
from ..worker.results import RateMeter, Result, SourceInfo, SourceState

#: Interval between updates while frames play, in seconds.
INTERVAL_S = 0.2
#: Times below this are shown as 0: the stage is cached or was skipped.
_MIN_SHOWN_MS = 0.05


class FrameDetails(Card):
    """The numbers of the newest frame that the status bar does not show: rates, losses, skew and times."""

    def __init__(self) -> None:
        super().__init__()
        self.setAccessibleName("Details of the frame")
        self.setToolTip("A stage that is cached or skipped is left out. Unmatched: images without a partner in time")
        self.label = QLabel()
        self.label.setWordWrap(True)
        self.label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.label.setMinimumHeight(9 * self.label.fontMetrics().lineSpacing())  # so that nothing moves
        vbox(self.label, within=self, margins=(8, 4, 8, 4))
        self.hide()

    def show_result(self, result: Result, shown_fps: float) -> None:
        patch, runs = result.patch, result.playback.playing
        stages = {} if patch is None else patch.stage_ms
        computed = [f"{stage} {ms:.1f}" for stage, ms in stages.items() if ms >= _MIN_SHOWN_MS]
        times = f"{' + '.join(computed)} = {sum(stages.values()):.1f} ms" if computed else "unchanged"
        points = "none" if patch is None else counted(len(patch.points), "point")
        if patch is not None and patch.averaged_frames > 1:
            points += f", mean of {patch.averaged_frames} frames"
        lines = (
            f"Drawn: {shown_fps:.0f} frames/s" if runs else "Drawn: paused",
            f"Dropped: {result.dropped}",
            f"Unmatched: {result.unmatched}",
            f"Skew, tactile minus proximity: {minus(f'{1e3 * result.frame.skew_s:z.1f} ms')}",
            f"Patch: {points}",
            f"Reading: {result.read_ms:.1f} ms",
            f"Drawing: {result.render_ms:.1f} ms",
            f"Stages: {times}",
        )
        self.label.setText("\n".join(lines))


class FrameStatus(QStatusBar):
    """What the source does, frame rate and patch area, a few times a second."""

    def __init__(self) -> None:
        super().__init__()
        self.setSizeGripEnabled(False)
        self.setContentsMargins(0, 0, 8, 0)
        self._shown_rate = RateMeter()
        self._last_s = 0.0
        self._playback, self._stale, self._recording = PlaybackState(), False, False
        self.details = FrameDetails()  # the window puts it over the views
        self.state = _flat_button("Rates, dropped frames, skew and times of the stages", "chevron-up")
        self.state.setText("No source")
        self.state.setCheckable(True)
        self.state.toggled.connect(self.details.setVisible)
        self.details.closed.connect(lambda: self.state.setChecked(False))
        self.addWidget(self.state)
        self._source = ElidedLabel()
        self.addWidget(self._source, 1)
        self.findings = _flat_button("What is wrong with this frame or preset, and what mends it (Ctrl+F)", "")
        self.findings.setIcon(icon("alert-outline", "warning"))
        self.publishing = _flat_button("Connections to Foxglove and ROS 2: state, or end them (Ctrl+Shift+P)", "")
        for button in (self.findings, self.publishing):
            button.hide()
            self.addPermanentWidget(button)
        self._rate = self._number("000 fps", "Frames per second drawn")
        self._area = self._number("patch 000,000 mm², touches 100 %", "")

    def show_source(self, info: SourceInfo) -> None:
        rig = info.rig
        cameras = " + ".join(f"{camera.model} {camera.serial}".strip() for camera in rig.cameras)
        length = "" if info.length is None else f", {counted(info.length, 'frame')}"
        self._source.setText(f"{info.name}{length}, {cameras}")

    def show_findings(self, count: int) -> None:
        self.findings.setText(counted(count, "finding"))
        self.findings.setVisible(count > 0)

    def show_state(self, state: SourceState) -> None:
        self._stale = state.stale
        self._show_words()

    def show_playback(self, state: PlaybackState) -> None:
        self._playback = state
        if not state.playing:
            self._rate.setText("")
        self._show_words()

    def show_recording(self, running: bool) -> None:
        self._recording = running
        self._show_words()

    def show_result(self, result: Result) -> None:
        """Count a frame as shown. The area is that of the views; the other numbers wait for `INTERVAL_S`."""
        self._shown_rate.tick()
        self._show_patch(result)
        now = time.perf_counter()
        running = result.playback.playing
        if running and now - self._last_s < INTERVAL_S:
            return
        self._last_s = now
        shown_fps = self._shown_rate.rate()
        self._rate.setText(f"{shown_fps:.0f} fps" if running else "")
        self.details.show_result(result, shown_fps)

    def _show_patch(self, result: Result) -> None:
        words = "" if result.patch is None else f"patch {result.area_mm2:,.0f} mm²"
        tip = "Area of the patch, projected along the optical axis"
        if (doubt := result.doubt) is not None and result.area_mm2 > 0:
            words += f", touches {math.floor(100 * doubt.touch_probability)} %"  # never 90 for what is hatched
            tip += ", and the probability that the membrane touches there"
            if math.isfinite(doubt.boundary_error_mm):
                tip += f". Expected error of the boundary: {doubt.boundary_error_mm:.1f} mm"
            if doubt.reasons:
                tip += f". Doubt: {', '.join(doubt.reasons)}"
        self._area.setText(words)
        self._area.setToolTip(f"{tip}.")

    def _show_words(self) -> None:
        playback = self._playback
        if self._stale:
            words = "No frames"
        elif not playback.playing:
            words = "Paused"
        else:
            words = "Live" if playback.length is None else "Playing"
        self.state.setText(f"Recording, {words.lower()}" if self._recording else words)
        self.state.setAccessibleName(f"{self.state.text()}: details of the frame")

    def _number(self, widest: str, tip: str) -> QLabel:
        label = number_label(widest, tip)
        # otherwise each number would lay out the whole window again
        label.setFixedSize(label.minimumWidth(), label.fontMetrics().height())
        label.setAutoFillBackground(True)  # nor paint what is behind it
        self.addPermanentWidget(label)
        return label


def _flat_button(tip: str, icon_name: str) -> QPushButton:
    button = QPushButton()
    button.setFlat(True)
    button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
    button.setToolTip(tip)
    if icon_name:
        button.setIcon(icon(icon_name))
    return button
