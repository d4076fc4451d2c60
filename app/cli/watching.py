"""``tactune run --watch``: the drift watchdog beside the frames of a run."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from shlex import quote
from typing import TYPE_CHECKING, Any

from .common import warn

if TYPE_CHECKING:
    from ...core.model.frames import SensorFrame
    from ...core.preset import Preset
    from ...core.rig.watch import Watchdog, WatchReport
    from ...core.sources import FrameSource


class Watching:
    """Looks once in ten seconds of the source's time and warns of each change.

    A live source's look runs on another thread, so no frame waits for it; a recording waits, so its result is the same
    each time.

    Parameters
    ----------
    preset : Preset
    origin : str
        Where the preset came from, as given to `load_preset`.
    source : FrameSource

    Raises
    ------
    CalibrationError
        There is nothing to compare with.
    """

    def __init__(self, preset: Preset, origin: str, source: FrameSource) -> None:
        from ...core.rig.untouched import find_untouched
        from ...core.rig.watch import Watchdog

        found = find_untouched(preset, origin, source)
        warn(*found.warnings)
        self._watchdog: Watchdog = Watchdog(preset, source.rig, found.frame)
        self._remedy = f"Check with: tactune recheck --preset {quote(origin)} --source {quote(source.name)}"
        self._live = source.length is None
        self._pool = ThreadPoolExecutor(1)
        self._look: Future[WatchReport | None] | None = None

    def __call__(self, frame: SensorFrame) -> dict[str, Any] | None:
        """Return the record of a look that has ended, for JSON; None if none has."""
        time_s = frame.proximity_time_s
        if self._look is None and self._watchdog.due(time_s):
            self._look = self._pool.submit(self._watchdog.look, frame, time_s)
        if self._look is None or (self._live and not self._look.done()):
            return None
        report = self._look.result()
        self._look = None
        if report is not None:
            remedy = f" {self._remedy}" if report.state == "told" else ""
            warn(f"{report.time_s:.1f} s: {report.sentence}{remedy}")
        return watch_record(self._watchdog, report)

    def close(self) -> None:
        """End the thread."""
        self._pool.shutdown()


def watch_record(watchdog: Watchdog, report: WatchReport | None) -> dict[str, Any]:
    """Return what a look measured, millimetres or percent, what is told at present, and what this look decided."""
    measured = {
        f"{subject}_percent" if subject.endswith("_lens") else f"{subject}_mm": round(
            value * (1e2 if subject.endswith("_lens") else 1e3), 3
        )
        for subject, value in watchdog.readings.items()
    }
    return {
        "measured": measured,
        "told": watchdog.told,
        "state": None if report is None else report.state,
        "subject": None if report is None else report.subject,
        "sentence": None if report is None else report.sentence,
    }
