"""Where the untouched membrane comes from while the source belongs to another thread."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ...core.errors import SourceError
from ...core.model.frames import Rig, SensorFrame
from ...core.preset import Preset
from ...core.rig.untouched import FoundUntouched, find_untouched
from ...core.sources.base import FrameSource, Progress

#: Gives the untouched frame for a preset and its file; may take long, and raises a `TactuneError`.
FindUntouched = Callable[[Preset, Path | None, Progress], FoundUntouched]


def no_untouched(_preset: Preset, _path: Path | None, _progress: Progress) -> FoundUntouched:
    """Find nothing."""
    return FoundUntouched(None)


def untouched_finder(source: FrameSource) -> FindUntouched:
    """Return what finds an untouched frame as `find_untouched` does, on any thread, while the source is being read.

    What the source keeps is read here and now, by whoever owns it. The simulator's is measured when it
    is asked for, in a scene of its own.
    """
    kept = _Kept(source)

    def find(preset: Preset, path: Path | None, progress: Progress) -> FoundUntouched:
        from ...core.sources.simulator.source import SimulatorSource  # other sources need not wait for it

        return find_untouched(preset, path, source if isinstance(source, SimulatorSource) else kept, progress)

    return find


class _Kept(FrameSource):
    """Stands for a source as far as its untouched frame is concerned."""

    def __init__(self, source: FrameSource) -> None:
        self.name, self._rig = source.name, source.rig
        self._untouched: SensorFrame | None = None
        self._problem: SourceError | None = None
        try:
            self._untouched = source.untouched()
        except SourceError as error:
            self._problem = error

    @property
    def rig(self) -> Rig:
        """The rig that took the frames."""
        return self._rig

    def next_frame(self) -> SensorFrame | None:
        """Return nothing: frames are another thread's."""
        return None

    def untouched(self) -> SensorFrame | None:
        """Return what the source kept when it was opened."""
        if self._problem is not None:
            raise self._problem
        return self._untouched
