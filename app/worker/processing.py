"""Processes one frame: finds the contact patch and draws what is visible, also for two presets that are compared."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace

from ...core.contact.pipeline import ContactPatch, ContactPipeline
from ...core.errors import TactuneError, as_sentence, counted
from ...core.model.frames import Rig, SensorFrame
from ...core.model.patch import Doubt
from ...core.preset import Preset
from ...core.rig.untouched import FoundUntouched
from ..document.comparison import Sides
from .playback import PlaybackState
from .rendering import Renderer
from .results import ComparedFrame, ComparedSide, Rendered, Result, SourceInfo, Wanted

#: Shortest time between two histograms, numbers of points, reasons of an empty patch or ranges of
#: the depth colours while frames play, seconds: nobody reads them faster.
COUNTING_INTERVAL_S = 0.2
#: Shortest time between two drawings of the images while frames play, seconds. The views show every frame.
STRIP_INTERVAL_S = 0.09
#: Share of the images' full resolution that is enough while frames play.
_RUNNING_SHARE = 0.8
#: Number of frames whose times are kept for a comparison.
TIMED_FRAMES = 30


class PatchFinder:
    """The pipeline of one preset, made when it is first needed."""

    def __init__(self, missing: Callable[[Preset], str], follows: bool = False) -> None:
        self._missing, self._follows = missing, follows
        self.preset = Preset()
        self.warnings: tuple[str, ...] = ()
        self.patch: ContactPatch | None = None
        #: Why the preset cannot be used with the rig; empty if it can.
        self.problem = ""
        #: What the patch waits for; empty if for nothing.
        self.waiting = ""
        self._pipeline: ContactPipeline | None = None
        self._untouched: SensorFrame | None = None
        self._frame: SensorFrame | None = None
        #: Whether a check for drift found that a camera has moved.
        self.cameras_moved = False
        #: Milliseconds of recent frames; not of the first, for which tables are made.
        self.times_ms: deque[float] = deque(maxlen=TIMED_FRAMES)

    def find(self, frame: SensorFrame, preset: Preset, rig: Rig, untouched: SensorFrame | None = None) -> None:
        """Find the patch, or say why this preset cannot be used with this rig; ``untouched`` is the preset's frame.

        While its contact test is compiled, a finder that ``follows`` edits keeps the preset that it had.
        """
        self.waiting = self._missing(preset)
        self.preset = preset
        if self.waiting and (not self._follows or self._pipeline is None):
            self.patch, self.problem, self.warnings = None, "", ()
            return
        if self.waiting and self._pipeline is not None:
            self.preset = preset = self._pipeline.preset
            untouched, self.waiting = self._untouched, f"Still the {preset.contact_test} test. {self.waiting}"
        kept = True
        try:
            if self._pipeline is None or untouched is not self._untouched:
                self._pipeline, self._untouched, kept = ContactPipeline(preset, rig, untouched), untouched, False
            elif self._pipeline.preset is not preset:
                self._pipeline.update(preset)
                kept = False
            self.warnings = tuple(self._pipeline.warnings)
            self._pipeline.cameras_moved = self.cameras_moved
            self.patch, self.problem = self._pipeline.process(frame), ""
        except TactuneError as error:
            self._pipeline, self.patch, self.problem, self.warnings = None, None, as_sentence(str(error)), ()
            return
        if not kept:
            self.times_ms.clear()
        elif frame is not self._frame:
            self.times_ms.append(sum(self.patch.stage_ms.values()))
        self._frame = frame


class FrameProcessor:
    """Holds the pipelines of the present source and counts processed frames."""

    def __init__(
        self,
        missing: Callable[[Preset], str] = lambda preset: "",
        untouched: Callable[[SourceInfo, Preset], FoundUntouched] = lambda info, preset: FoundUntouched(None),
    ) -> None:
        self._missing, self._stored_untouched = missing, untouched
        self._renderer = Renderer()
        self._present = PatchFinder(missing, follows=True)
        self._others: list[PatchFinder] = []
        self._processed = 0
        self._doubt: Doubt | None = None
        self._counted_s, self._strip_s = -COUNTING_INTERVAL_S, -STRIP_INTERVAL_S

    def set_cameras_moved(self, moved: bool) -> None:
        self._present.cameras_moved = moved

    def forget(self) -> None:
        self._present, self._others = PatchFinder(self._missing, follows=True), []
        self._counted_s, self._strip_s = -COUNTING_INTERVAL_S, -STRIP_INTERVAL_S

    def process(
        self,
        info: SourceInfo,
        frame: SensorFrame,
        preset: Preset,
        wanted: Wanted,
        playback: PlaybackState,
        *,
        compared: Sides | None = None,
        held: bool = False,
    ) -> Result:
        """Return the patch and what the window shows; of a frame that is ``held`` all is drawn, also while it plays."""
        untouched = self._stored_untouched(info, preset)
        self._present.find(frame, preset, info.rig, untouched.frame)
        finders = self._find_compared(frame, info, compared)
        started = time.perf_counter()
        if self._present.waiting and not self._processed:  # the images' kernels are compiled after the first picture
            wanted = replace(wanted, images=frozenset())
        if playback.playing and not held:
            wanted = self._due(wanted, started)
        if compared is None:
            rendered, both = self._render(self._present, frame, info.rig, wanted), None
        else:
            both = self._render_compared(compared, finders, frame, info.rig, wanted)
            hidden = replace(wanted, clouds=frozenset(), images=frozenset())
            shown = [side.rendered for side in (both.a, both.b) if side.side.follows]
            rendered = shown[0] if shown else self._render(self._present, frame, info.rig, hidden)
        render_ms = 1e3 * (time.perf_counter() - started)
        self._processed += 1
        patch = self._present.patch
        if patch is None:
            self._doubt = None
        elif self._doubt is None or wanted.words or bool(len(patch.points)) != bool(self._doubt.touch_probability):
            # the last: contact began or ended
            self._doubt = told_doubt(patch)
        return Result(
            source=info,
            frame=frame,
            preset=self._present.preset,
            patch=patch,
            area_mm2=patch.area_mm2 if patch is not None else 0.0,
            doubt=self._doubt,
            force_arrow_m=patch.force_arrow_m if patch is not None else None,
            rendered=rendered,
            playback=playback,
            untouched=untouched.frame,
            problem=self._present.problem,
            waiting=self._present.waiting,
            warnings=(*map(as_sentence, untouched.warnings), *self._present.warnings),
            processed=self._processed,
            render_ms=render_ms,
            compared=both,
        )

    def _due(self, wanted: Wanted, now_s: float) -> Wanted:
        """Leave out what was drawn a short time ago, and draw the images a little coarser."""
        counts, draws = now_s - self._counted_s >= COUNTING_INTERVAL_S, now_s - self._strip_s >= STRIP_INTERVAL_S
        self._counted_s, self._strip_s = now_s if counts else self._counted_s, now_s if draws else self._strip_s
        return replace(
            wanted,
            histograms=wanted.histograms if counts else frozenset(),
            words=counts,
            images=wanted.images if draws else frozenset(),
            strip_width=round(_RUNNING_SHARE * wanted.strip_width),
        )

    def _find_compared(self, frame: SensorFrame, info: SourceInfo, sides: Sides | None) -> list[PatchFinder]:
        """Find the patches of compared presets; each keeps its own pipeline, for its cached steps and averages."""
        presets = [side.preset for side in sides or () if not side.follows]
        kept = [finder for finder in self._others if any(finder.preset is preset for preset in presets)]
        spare = [finder for finder in self._others if finder not in kept]
        for preset in presets:
            if not any(finder.preset is preset for finder in kept):
                kept.append(spare.pop() if spare else PatchFinder(self._missing))
                kept[-1].preset = preset
        self._others = kept
        for finder in kept:
            finder.find(frame, finder.preset, info.rig, self._stored_untouched(info, finder.preset).frame)
        return [
            self._present if side.follows else next(finder for finder in kept if finder.preset is side.preset)
            for side in sides or ()
        ]

    def _render_compared(
        self, sides: Sides, finders: list[PatchFinder], frame: SensorFrame, rig: Rig, wanted: Wanted
    ) -> ComparedFrame:
        wanted = replace(wanted, words=True)
        uncounted = replace(wanted, histograms=frozenset())
        for finder in finders:
            self._renderer.measure(frame, finder.preset, rig)
        a, b = (
            ComparedSide(
                replace(side, preset=finder.preset), finder.patch, finder.problem,
                finder.patch.area_mm2 if finder.patch is not None else 0.0, tuple(finder.times_ms),
                self._render(finder, frame, rig, wanted if side.follows else uncounted),
            )
            for side, finder in zip(sides, finders, strict=True)
        )  # fmt: skip
        return ComparedFrame(a, b)

    def _render(self, finder: PatchFinder, frame: SensorFrame, rig: Rig, wanted: Wanted) -> Rendered:
        rendered = self._renderer.render(frame, finder.patch, finder.preset, rig, wanted)
        return replace(rendered, no_contact=finder.waiting) if finder.waiting else rendered


def told_doubt(patch: ContactPatch) -> Doubt:
    """Return the doubt about a patch; a reason that holds for some of its contacts only is told with their areas."""
    told, count = [], len(patch.contacts)
    for reason in patch.doubt.reasons:
        areas = [f"{each.area_mm2:,.0f}" for each in patch.contacts if reason in each.doubt.reasons]
        of = f" ({counted(len(areas), 'contact')} of {count}: {', '.join(areas)} mm²)"
        told.append(reason + of if len(areas) < count else reason)
    return patch.doubt._replace(reasons=tuple(told))
