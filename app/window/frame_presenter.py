"""Puts a processed frame onto the widgets."""

from __future__ import annotations

import time

from PyQt6.QtCore import QObject, QTimer

from ...core.sources.base import CameraRole
from ...widgets.basics.theme import theme_name
from ...widgets.images.image_strip import ImageStrip
from ...widgets.parameters.parameter_panel import ParameterPanel
from ..document.document import Document
from ..worker.results import CloudName, Result, SourceState
from .message_bar import MessageBar, Severity
from .readout import readout
from .staleness import badge, short_badge, source_sentence
from .status import FrameStatus
from .transport import Transport
from .view_area import ViewArea

#: The histogram and the readout are read, not watched; while frames run, a few times a second do.
READING_INTERVAL_S = 0.1
#: How often the age of an old frame is told anew.
AGE_INTERVAL_MS = 500

#: Whose images each view is made of.
_CAMERAS: dict[CloudName, tuple[CameraRole, ...]] = {
    CloudName.PROXIMITY: ("proximity",),
    CloudName.TACTILE: ("tactile",),
    CloudName.PATCH: ("proximity", "tactile"),
}


class FramePresenter(QObject):
    """Shows results in views, strip, panel, controls and status bar; remembers the newest."""

    def __init__(
        self,
        document: Document,
        *,
        views: ViewArea,
        strip: ImageStrip,
        panel: ParameterPanel,
        transport: Transport,
        status: FrameStatus,
        messages: MessageBar,
    ) -> None:
        super().__init__(document)
        self._document = document
        self._views, self._strip, self._panel = views, strip, panel
        self._transport, self._status, self._messages = transport, status, messages
        self._result: Result | None = None
        self._pixel = (-1, -1)
        self._read_s = 0.0
        self._said: tuple[str, ...] = ()
        self._state = SourceState()
        self._ages = QTimer(self)
        self._ages.setInterval(AGE_INTERVAL_MS)
        self._ages.timeout.connect(self._show_badges)
        strip.hovered.connect(self._hovered)

    @property
    def result(self) -> Result | None:
        """What is shown now; None before the first frame of a source."""
        return self._result

    def forget(self) -> None:
        """Begin with another source."""
        self._result = None
        self._said = ()
        for key in ("problem", "rig"):
            self._messages.clear(key)
        self.show_state(SourceState())

    def show_state(self, state: SourceState) -> None:
        """Show how the source is doing: over the views what is old, above them what else is wrong."""
        self._state = state
        self._messages.state("health", Severity.WARNING, source_sentence(state))
        self._status.show_state(state)
        self._show_badges()
        if state.stale:
            self._ages.start()
        else:
            self._ages.stop()

    def _show_badges(self) -> None:
        now_s, shown = time.monotonic(), self._result is not None
        self._views.show_badges({name: badge(self._state, roles, now_s, shown) for name, roles in _CAMERAS.items()})
        self._strip.set_badge(short_badge(self._state, now_s) if shown else "")

    def show(self, result: Result) -> None:
        """Show a result; what was not drawn for it stays as it is."""
        self._result = result
        self._views.show_result(result, theme_name())
        if result.rendered.strip is not None:
            self._strip.set_images(result.rendered.strip)
        runs = result.playback.running
        now = time.perf_counter()
        if not runs or now - self._read_s >= READING_INTERVAL_S:
            self._read_s = now
            self._show_readings(result)
        self._transport.show_state(result.playback)
        self._status.show_result(result)
        self._show_warnings(result)

    def _show_readings(self, result: Result) -> None:
        histogram = result.rendered.histogram
        if histogram is not None:
            self._panel.set_histogram(histogram.counts, histogram.edges, self._document.preset.tolerance.t)
        self._panel.set_median_distance_m(result.rendered.median_distance_m)
        self._show_readout()

    def _show_warnings(self, result: Result) -> None:
        """Say what is wrong once; a dismissed sentence stays away until it changes."""
        said = (result.problem, *result.warnings)
        if said == self._said:
            return
        self._said = said
        self._messages.state("problem", Severity.ERROR, result.problem)
        self._messages.state("rig", Severity.WARNING, " ".join(result.warnings))

    def _hovered(self, u: int, v: int) -> None:
        self._pixel = u, v
        self._show_readout()

    def _show_readout(self) -> None:
        self._strip.set_readout(readout(self._result, *self._pixel) if self._result is not None else "")
