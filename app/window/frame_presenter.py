"""Shows processed frames in the widgets: clouds, images, numbers, problems, and badges over old images."""

from __future__ import annotations

import math

from PyQt6.QtCore import QObject

from ...core.contact.pipeline import ContactPatch
from ...core.errors import minus
from ...core.model.patch import Provenance
from ...core.sources.base import CameraHealth, CameraRole
from ...widgets.basics.messages import Severity
from ...widgets.basics.overlays import Wipe
from ...widgets.basics.theme import THEME
from ...widgets.images.image_strip import ImageStrip
from ...widgets.parameters.parameter_panel import ParameterPanel
from ..context import SOURCE, Context
from ..worker.results import CloudName, Pace, Result, SourceState
from .pointing import hsv_words
from .status import INTERVAL_S, FrameStatus, patch_readings
from .toolbar import Transport
from .view_area import ViewArea

_STATES = {"missing": "is not connected: plug it in", "stalled": "sends no images: check its cable"}


def camera_sentence(camera: CameraHealth) -> str:
    """Return what is wrong with a camera and what to do; empty while it streams."""
    if camera.state == "streaming":
        return ""
    if camera.message:
        return camera.message.rstrip(".") + "."
    serial = f"(serial {camera.serial})" if camera.serial else ""
    name = " ".join(part for part in (camera.role.capitalize(), "camera", camera.model, serial) if part)
    return f"{name} {_STATES[camera.state]}."


def badge(state: SourceState, roles: tuple[CameraRole, ...], shown: bool) -> str:
    """Return the text over a view of one or both cameras; empty while frames come."""
    faulty = {camera.role: said for camera in state.health.cameras if (said := camera_sentence(camera))}
    own = [faulty[role] for role in roles if role in faulty]
    if not state.stale and not own:
        return ""
    if not own:
        own = [f"Waiting for the {role} camera." for role in faulty] or [state.problem or "No new frame has arrived."]
    if state.stale and shown:
        own.append("The last frame is shown.")
    return " ".join(own)


def readout(patch: ContactPatch | None, u: int, v: int, color: str = "") -> str:
    """Return a line on a proximity pixel: why it was kept or dropped, then numbers: a narrow window cuts the end."""
    if patch is None:
        return color
    height, width = patch.rig.proximity.intrinsics.shape
    if not (0 <= u < width and 0 <= v < height):
        return ""
    expected, measured = float(patch.aligned.expected_m[v, u]), float(patch.aligned.measured_m[v, u])
    relative = float(patch.relative_difference[v, u])
    verdict = Provenance(int(patch.provenance[v, u]))
    why, gap_m = verdict.explanation, math.nan if patch.membrane is None else float(patch.membrane.gap_m.get()[v, u])
    gap = f"gap {1e3 * gap_m:.2f} mm" if math.isfinite(gap_m) else ""
    if gap and verdict is Provenance.RIM:
        why, gap = f"{gap}: outside the edge of contact", ""
    pressure = patch.pressure
    if pressure is not None and verdict is Provenance.OUTSIDE_TOLERANCE:
        why = "Dropped: no contact pressure above the limit, or outside the edge of contact."
    q = math.nan if pressure is None else float(pressure.relative.get()[v, u])
    if pressure is not None and math.isfinite(q):
        known = pressure.inflation_pa > 0
        gap = f"pressure {1e-3 * pressure.inflation_pa * q:.2f} kPa" if known else f"pressure {q:.2f} × inflation"
    two, difference = patch.rig.has_proximity, ""
    if two and math.isfinite(relative):
        difference = f"(dp − dt) / dp = {minus(f'{relative:+.1%} ({1e3 * (expected - measured):+.1f} mm)')}"
    distances = f"dp {_metres(expected)}" if two else "", f"dt {_metres(measured)}"
    return "   ".join(filter(None, (f"({u}, {v})", why, *distances, gap, difference, color)))


def _metres(value: float) -> str:
    return f"{value:.4f} m" if math.isfinite(value) else "none"


#: The cameras that each view needs.
_CAMERAS: dict[CloudName, tuple[CameraRole, ...]] = {
    CloudName.PROXIMITY: ("proximity",),
    CloudName.TACTILE: ("tactile",),
    CloudName.PATCH: ("proximity", "tactile"),
}


class FramePresenter(QObject):
    """Shows results in views, strip, panel, playback controls and status bar."""

    def __init__(
        self,
        context: Context,
        views: ViewArea,
        strip: ImageStrip,
        panel: ParameterPanel,
        transport: Transport,
        status: FrameStatus,
    ) -> None:
        super().__init__(context)
        self._context = context
        self._views, self._strip, self._panel = views, strip, panel
        self._transport, self._status, self._messages = transport, status, context.messages
        self._pixel = (-1, -1)
        self._pace = Pace(INTERVAL_S)
        self._shown_problem = ""
        self._has_color = False
        self._share = 0.5
        strip.hovered.connect(self._hovered)

    def forget(self) -> None:
        self._context.result = None
        self._has_color = False
        self._shown_problem = ""
        self.show_state(SourceState())

    def show_state(self, state: SourceState) -> None:
        """Show the state of the source: badges over old images, other problems as a message."""
        self._messages.state("health", Severity.WARNING, state.health.message, SOURCE)
        self._status.show_state(state)
        shown = self._context.result is not None
        self._badges = {name: badge(state, roles, shown) for name, roles in _CAMERAS.items()}
        self._views.show_badges(self._badges)
        self._strip.set_badge("old" if shown and state.stale else "")

    def show(self, result: Result) -> None:
        """Show a result; widgets for which nothing was drawn stay unchanged."""
        self._context.result = result
        self._context.playback = result.playback  # results overtake the worker's own announcement
        wipe, compared = self._wipe(), result.compared
        self._views.show_result(result, THEME.name, wipe)
        old_patch = result.waiting if result.patch is not None else ""
        self._views.show_badges(self._badges | ({CloudName.PATCH: old_patch} if old_patch else {}))
        self._strip.set_wipe(wipe)
        strip = (result if compared is None else compared.a).rendered.strip
        if strip is not None:
            self._strip.set_images(strip, None if compared is None else compared.b.rendered.strip)
        histogram = result.rendered.histogram
        if histogram is not None:  # the worker counts less often than frames come
            shown = self._panel.histograms[histogram.field]
            shown.set_data(histogram.counts, histogram.edges, histogram.known)
        elif result.patch is None:
            for shown in self._panel.histograms.values():
                shown.clear()
        shown_fps = self._status.show_result(result)
        readings = patch_readings(result, shown_fps) if compared is None else ()  # they belong to the picture
        self._views.views[CloudName.PATCH].set_readings(readings)
        if self._pace.due(result):
            live = result.source.length is None  # whose first images may be black
            self._has_color = self._has_color or live or bool(result.frame.proximity_color.any())
            self._strip.set_color(self._has_color)
            self._panel.set_median_distance_m(result.rendered.median_distance_m)
            if strip is not None:  # else it is drawn with a later frame
                self._panel.show_masked_share(strip.masked_share)
            self._show_readout()
            self._transport.show_state(result.playback)
        # once, unless the patch view says it; a dismissed problem comes back only after a change
        problem = result.problem if self._views.views[CloudName.PATCH].isHidden() else ""
        if problem != self._shown_problem:
            self._shown_problem = problem
            self._messages.state("problem", Severity.ERROR, problem, SOURCE)

    def set_wipe_share(self, share: float) -> None:
        """Move the wipe between two compared presets: 1 shows only A, 0 only B."""
        self._share = share
        self._views.set_wipe(self._wipe())
        self._strip.set_wipe(self._wipe())
        self._show_readout()

    def _wipe(self) -> Wipe | None:
        """Return the wipe over the frame on the screen; None unless it was processed with two presets."""
        compared = self._context.result.compared if self._context.result is not None else None
        if compared is None:
            return None
        return Wipe(self._share, f"A: {compared.a.side.name}", f"B: {compared.b.side.name}")

    def _hovered(self, u: int, v: int) -> None:
        self._pixel = u, v
        self._show_readout()

    def _show_readout(self) -> None:
        result = self._context.result
        if result is None:
            self._status.readout.setText("")
            return
        color, compared = hsv_words(result, *self._pixel), result.compared
        if compared is None:
            self._status.readout.setText(readout(result.patch, *self._pixel, color))
            return
        right = self._strip.right_of_wipe(self._pixel[0])
        text = readout((compared.b if right else compared.a).patch, *self._pixel, color)
        self._status.readout.setText(text and f"{'B' if right else 'A'}   {text}")
