"""The status bar: state, and the pixel under the mouse; the numbers on the patch, and the others of a frame."""

from __future__ import annotations

import math

from PyQt6.QtCore import Qt
from PyQt6.QtWidgets import QLabel, QPushButton, QStatusBar

from ...core.errors import counted, minus
from ...widgets.basics.controls import ElidedLabel, named
from ...widgets.basics.overlays import Reading
from ..worker.playback import PlaybackState
from ..worker.results import Pace, RateMeter, Result, SourceState

#: Interval between updates of numbers while frames play, in seconds: nobody reads them faster.
INTERVAL_S = 0.2
#: Times below this are shown as 0: the stage is cached or was skipped.
_MIN_SHOWN_MS = 0.05
_UNKNOWN = "–"


def patch_readings(result: Result, shown_fps: float) -> tuple[Reading, ...]:
    """Return the numbers that stand on the patch: area, doubt, centroid and frame rate; only this without a patch."""
    patch, doubt = result.patch, result.doubt
    rate = [Reading(f"{shown_fps:.0f} fps", "frame rate", "00 fps")] if result.playback.playing else []
    if patch is None:
        return tuple(rate)
    touches = boundary = centroid = _UNKNOWN
    if patch.centroid_m is not None:
        x, y, z = (1e3 * value for value in patch.centroid_m)
        centroid = minus(f"{x:z.0f}, {y:z.0f}, {z:z.0f}")
    if doubt is not None and result.area_mm2 > 0:
        touches = f"{math.floor(100 * doubt.touch_probability)} %"  # never 90 for what is hatched
        if math.isfinite(doubt.boundary_error_mm):
            boundary = f"±{doubt.boundary_error_mm:.1f} mm"
    area, force = f"{result.area_mm2:,.0f} mm²", []
    if patch.pressure is not None:
        names = ("force over inflation", "00,000 ± 0,000 mm²") if patch.force_n is None else ("force", "00.00 ± 0.00 N")
        force = [Reading((result.area_mm2 > 0 and patch.pressure.words()) or _UNKNOWN, *names)]
    return (
        Reading(area, "area", max("00,000 mm²", area, key=len)),
        Reading(touches, "touches", "100 %"),
        Reading(boundary, "boundary", "±00.0 mm"),
        *force,
        Reading(centroid, "centroid x, y, z in mm", "−000, −000, 000"),
        *rate,
    )


class FrameDetails(QLabel):
    """The numbers of the newest frame that do not stand on the patch: doubt, losses, skew and times."""

    def __init__(self) -> None:
        super().__init__()
        tip = "A stage that is cached or skipped is left out. Unmatched: images without a partner in time"
        named(self, "Details of the frame", tip)
        self.setWordWrap(True)
        self.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        self.setMinimumHeight(9 * self.fontMetrics().lineSpacing())  # so that nothing moves
        self.setAlignment(Qt.AlignmentFlag.AlignTop)

    def show_result(self, result: Result) -> None:
        patch, doubt = result.patch, result.doubt
        stages = {} if patch is None else patch.stage_ms
        computed = [f"{stage} {ms:.1f}" for stage, ms in stages.items() if ms >= _MIN_SHOWN_MS]
        times = f"{' + '.join(computed)} = {sum(stages.values()):.1f} ms" if computed else "nothing new to compute"
        points = "none" if patch is None else counted(len(patch.points), "point")
        if patch is not None and patch.averaged_frames > 1:
            points += f", mean of {patch.averaged_frames} frames"
        lines = (
            f"Doubts about contact: {'not judged' if doubt is None else ', '.join(doubt.reasons) or 'none'}",
            f"Patch: {points}",
            f"Dropped: {result.dropped}, unmatched: {result.unmatched}",
            f"Skew, tactile minus proximity: {minus(f'{1e3 * result.frame.skew_s:z.1f} ms')}",
            f"Reading: {result.read_ms:.1f} ms, drawing: {result.render_ms:.1f} ms",
            f"Contact test: {result.preset.contact_test}, {times}",
        )
        self.setText("\n".join(lines))


class FrameStatus(QStatusBar):
    """What the source does, what is under the mouse, and whether patches are published."""

    def __init__(self) -> None:
        super().__init__()
        self.setSizeGripEnabled(False)
        self.setContentsMargins(0, 0, 8, 0)
        self._shown_rate = RateMeter()
        self._pace, self._shown_fps = Pace(INTERVAL_S), 0.0
        self._playback, self._stale, self._recording = PlaybackState(), False, False
        self.details = FrameDetails()  # the window puts it among the controls of a mode
        self.state = _flat_button("Dropped frames, skew and times of the stages: in Record and run (Ctrl+3)")
        self.state.setText("No source")
        self.addWidget(self.state)
        self.readout = ElidedLabel()  # it has a tooltip of its own only while its end is cut off
        self.setToolTip("dp: proximity distance in the tactile camera's frame, dt: tactile distance, both along z")
        self.addWidget(self.readout, 1)
        self.publishing = _flat_button("Connections to Foxglove and ROS 2: state, or end them (F8)")
        self.publishing.hide()
        self.addPermanentWidget(self.publishing)

    def show_state(self, state: SourceState) -> None:
        self._stale = state.stale
        self._show_words()

    def show_playback(self, state: PlaybackState) -> None:
        self._playback = state
        self._show_words()

    def show_recording(self, running: bool) -> None:
        self._recording = running
        self._show_words()

    def show_result(self, result: Result) -> float:
        """Count a frame as shown; return the frames shown per second, renewed with the details every `INTERVAL_S`."""
        self._shown_rate.tick()
        if self._pace.due(result):
            self._shown_fps = self._shown_rate.rate()
            self.details.show_result(result)
        return self._shown_fps

    def _show_words(self) -> None:
        playback = self._playback
        if self._stale:
            words = "No frames"
        elif not playback.playing:
            words = "Paused"
        else:
            words = "Live" if playback.length is None else "Playing"
        self.state.setText(f"Recording, {words.lower()}" if self._recording else words)


def _flat_button(tip: str) -> QPushButton:
    button = QPushButton()
    button.setFlat(True)
    button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
    button.setToolTip(tip)
    return button
