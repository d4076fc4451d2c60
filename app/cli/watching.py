"""``tactune run --watch``: the check for drift beside the frames of a run."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from shlex import quote
from typing import TYPE_CHECKING, Any

from .common import warn

if TYPE_CHECKING:
    from ...core.model.frames import SensorFrame
    from ...core.preset import Preset
    from ...core.rig.drift import WatchReport
    from ...core.sources import FrameSource


class Watching:
    """Looks once in ten seconds of the source's time and warns of each change.

    A live source's look runs on another thread, so no frame waits for it; a recording waits, so its result is the same
    each time.
    """

    def __init__(self, preset: Preset, origin: str, source: FrameSource) -> None:
        from ...core.rig.drift import Watch
        from ...core.rig.untouched import find_untouched

        found = find_untouched(preset, origin, source)
        warn(*found.warnings)
        self._watch = Watch(preset, source.rig, found.frame)
        self._remedy = f"Check with: tactune recheck --preset {quote(origin)} --source {quote(source.name)}"
        self._live = source.length is None
        self._pool = ThreadPoolExecutor(1)
        self._look: Future[WatchReport | None] | None = None

    def __call__(self, frame: SensorFrame) -> dict[str, Any] | None:
        """Return the record of a look that has ended, for JSON; None if none has."""
        time_s = frame.proximity_time_s
        if self._look is None and self._watch.due(time_s):
            self._look = self._pool.submit(self._watch.look, frame, time_s)
        if self._look is None or (self._live and not self._look.done()):
            return None
        report = self._look.result()
        self._look = None
        if report is not None:
            remedy = f" {self._remedy}" if report.state == "told" else ""
            warn(f"{report.time_s:.1f} s: {report.sentence}{remedy}")
        return self._record(report)

    def close(self) -> None:
        """End the thread."""
        self._pool.shutdown()

    def _record(self, report: WatchReport | None) -> dict[str, Any]:
        """Return what a look measured, millimetres, what is told at present, and what this look decided."""
        drift = self._watch.drift
        measured = {} if drift is None else drift.moved_m | {"inflation": drift.inflation_m}
        return {
            "measured": {f"{name}_mm": round(1e3 * value, 3) for name, value in measured.items()},
            "told": [] if self._watch.told == "fine" else [self._watch.told],
            "state": None if report is None else report.state,
            "subject": None if report is None else report.verdict,
            "sentence": None if report is None else report.sentence,
        }
