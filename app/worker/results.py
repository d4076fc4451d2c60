"""What the worker passes to the window: the source, its state, and one immutable result for each frame."""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from ...core.contact.pipeline import ContactPatch
from ...core.errors import PresetError, SourceError
from ...core.model.arrays import Float64Array, Int64Array
from ...core.model.frames import Rig, SensorFrame
from ...core.model.patch import Doubt, Provenance
from ...core.preset import Preset
from ...core.rig.untouched import FoundUntouched, find_untouched, kept_untouched
from ...core.sources.base import FrameSource, Health, Progress
from ...widgets.clouds.cloud_data import DepthCloud
from ...widgets.images.strip_render import IMAGES, RenderedStrip
from ..document.comparison import Side
from .playback import PlaybackState


class _AtRest(FrameSource):
    """A source reduced to its untouched frame, which is read now, on the thread that owns the source."""

    def __init__(self, source: FrameSource) -> None:
        self.name, self.rig = source.name, source.rig
        self._untouched: SensorFrame | None = None
        self._problem: SourceError | None = None
        try:
            self._untouched = source.untouched()
        except SourceError as error:
            self._problem = error

    def next_frame(self) -> SensorFrame | None:
        """Return None: the frames belong to another thread."""
        return None

    def untouched(self) -> SensorFrame | None:
        if self._problem is not None:
            raise self._problem
        return self._untouched


class CloudName(StrEnum):
    """The three views, left to right."""

    PROXIMITY = "proximity"
    TACTILE = "tactile"
    PATCH = "patch"


class ColorBy(StrEnum):
    """What the colour of a point means."""

    CONTACT = "contact"
    PROVENANCE = "provenance"
    PRESSURE = "pressure"  # where the contact test tells it, else as CONTACT


@dataclass(frozen=True)
class Wanted:
    """What the window shows now; nothing else is drawn.

    ``images`` are the names of those that are shown, ``strip_width`` is the width of one of them on the screen in
    pixels; 0 draws all pixels.
    ``histograms`` are the fields whose histograms are open; that of the contact test's own field is counted.
    ``words`` counts the points of both cameras, judges the patch or says why it is empty, and measures the range of the
    depth colours; else those of an earlier frame stay.
    """

    clouds: frozenset[CloudName] = frozenset(CloudName)
    color_by: ColorBy = ColorBy.CONTACT
    images: frozenset[str] = frozenset(IMAGES)
    strip_width: int = 0
    shows_mask: bool = True
    histograms: frozenset[str] = frozenset({"tolerance.t", "membrane.gap_m"})
    dark: bool = False
    words: bool = True


@dataclass(frozen=True, eq=False)
class Histogram:
    """Counts of what a preset field limits, in its unit; ``known`` values include those beyond the edges."""

    field: str
    counts: Int64Array
    edges: Float64Array
    known: int


@dataclass(frozen=True, eq=False)
class Rendered:
    """The images of one frame; those that are not visible are missing.

    ``color_by`` is what the clouds' colours mean. ``depth_range_m`` are the ends of the depth colours along the
    proximity camera's axis, ``tactile_range_m`` those along the tactile camera's axis. ``pressure_scale`` is the share
    of the inflation at the end of the pressure colours, and the inflation in Pa, 0 if unknown. ``verdicts`` are the
    `Provenance` values that occur, if points are coloured by them. ``no_contact`` says why a visible patch is empty or
    what it waits for, ``no_contact_action`` names the window's action that may help.
    """

    clouds: dict[CloudName, DepthCloud | None] = field(default_factory=dict)
    color_by: ColorBy = ColorBy.CONTACT
    strip: RenderedStrip | None = None
    histogram: Histogram | None = None
    median_distance_m: float = float("nan")
    depth_range_m: tuple[float, float] = (0.0, 1.0)
    tactile_range_m: tuple[float, float] = (0.0, 1.0)
    pressure_scale: tuple[float, float] = (1.0, 0.0)
    verdicts: frozenset[Provenance] = frozenset()
    no_contact: str = ""
    no_contact_action: str = ""


@dataclass(frozen=True)
class SourceInfo:
    """Facts about an open source."""

    name: str
    rig: Rig
    length: int | None
    frame_rate_hz: float
    preset: Preset | None = None
    at_rest: FrameSource | None = None
    times_s: Float64Array | None = field(default=None, compare=False)

    def find_untouched(self, preset: Preset, path: Path | None, progress: Progress) -> FoundUntouched:
        """Return the untouched frame for a preset and its file, from any thread; measuring it may take long."""
        return FoundUntouched(None) if self.at_rest is None else find_untouched(preset, path, self.at_rest, progress)

    def kept_untouched(self, preset: Preset, path: Path | None) -> FoundUntouched:
        """Return the same, but measure nothing."""
        return FoundUntouched(None) if self.at_rest is None else kept_untouched(preset, path, self.at_rest)

    @classmethod
    def of(cls, source: FrameSource) -> SourceInfo:
        """Return the facts about a source; an unusable preset becomes None."""
        from ...core.sources.simulator.simulator_source import SimulatorSource  # other sources need not wait for it

        try:
            preset = source.preset()
        except PresetError:
            preset = None
        at_rest = source if isinstance(source, SimulatorSource) else _AtRest(source)
        return cls(source.name, source.rig, source.length, source.frame_rate_hz, preset, at_rest, source.times_s())


@dataclass(frozen=True)
class SourceState:
    """State of the source, sent separately from its frames because it matters most while none come."""

    health: Health = field(default_factory=Health)
    stale: bool = False
    problem: str = ""


@dataclass(frozen=True, eq=False)
class ComparedSide:
    """One of two compared presets on one frame; ``times_ms`` are those of recent frames, without the first."""

    side: Side
    patch: ContactPatch | None
    problem: str
    area_mm2: float
    times_ms: tuple[float, ...]
    rendered: Rendered


@dataclass(frozen=True, eq=False)
class ComparedFrame:
    """Two compared presets on one frame."""

    a: ComparedSide
    b: ComparedSide


@dataclass(frozen=True, eq=False)
class Result:
    """One processed frame.

    ``patch`` is None if the preset cannot be used with this rig; ``problem`` says why. ``playback`` is as of reading.
    ``processed`` counts all frames since the start, ``dropped`` those that were replaced by newer ones before they were
    shown, ``unmatched`` images without a partner from the other camera. With ``compared``, ``rendered`` holds no clouds
    and no strip unless one of the two is the present preset.
    """

    source: SourceInfo
    frame: SensorFrame
    preset: Preset
    patch: ContactPatch | None
    area_mm2: float
    doubt: Doubt | None  # of the patch, or while frames play of one a moment before
    force_arrow_m: Float64Array | None  # as in `ContactPatch`
    rendered: Rendered
    playback: PlaybackState
    untouched: SensorFrame | None = None  # that is kept with the preset or the source
    problem: str = ""
    waiting: str = ""  # what the newest preset waits for; meanwhile ``preset`` and ``patch`` are of the one before
    warnings: tuple[str, ...] = ()
    processed: int = 0
    dropped: int = 0
    unmatched: int = 0
    read_ms: float = 0.0
    render_ms: float = 0.0
    compared: ComparedFrame | None = None

    @property
    def frame_number(self) -> int:
        """Number of the frame in its source, counted from 0 as in files and commands."""
        return self.playback.index


class Pace:
    """Says when it is time to show again what nobody reads faster than every ``interval_s`` while frames play."""

    def __init__(self, interval_s: float) -> None:
        self._interval_s, self._last_s = interval_s, -interval_s

    def due(self, result: Result) -> bool:
        now_s = time.perf_counter()
        if result.playback.playing and now_s - self._last_s < self._interval_s:
            return False
        self._last_s = now_s
        return True


class RateMeter:
    """Events per second over the last two seconds."""

    WINDOW_S = 2.0

    def __init__(self) -> None:
        self._times: deque[float] = deque()

    def tick(self) -> None:
        self._times.append(time.perf_counter())

    def rate(self) -> float:
        """Return the events per second; 0 if the last one is older than `WINDOW_S`."""
        now = time.perf_counter()
        while self._times and now - self._times[0] > self.WINDOW_S:
            self._times.popleft()
        if len(self._times) < 2:
            return 0.0
        return (len(self._times) - 1) / max(now - self._times[0], 1e-6)
