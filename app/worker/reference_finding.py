"""Where the untouched membrane comes from while the source belongs to another thread."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ...core.errors import SourceError
from ...core.model.frames import Rig, SensorFrame
from ...core.preset import Preset
from ...core.rig.untouched import FoundReference, find_reference
from ...core.sources.base import FrameSource, Progress

#: Gives the reference for a preset and its file; may take long, and raises a `TactuneError`.
FindReference = Callable[[Preset, Path | None, Progress], FoundReference]


def no_reference(_preset: Preset, _path: Path | None, _progress: Progress) -> FoundReference:
    """Find nothing."""
    return FoundReference(None)


def reference_finder(source: FrameSource) -> FindReference:
    """Return what finds a reference as `find_reference` does, on any thread, while the source is being read.

    What the source keeps is read here and now, by whoever owns it. The simulator's is measured when it
    is asked for, in a scene of its own.
    """
    kept = _Kept(source)

    def find(preset: Preset, path: Path | None, progress: Progress) -> FoundReference:
        from ...core.sources.simulator.source import SimulatorSource  # other sources need not wait for it

        return find_reference(preset, path, source if isinstance(source, SimulatorSource) else kept, progress)

    return find


class _Kept(FrameSource):
    """Stands for a source as far as its reference is concerned."""

    def __init__(self, source: FrameSource) -> None:
        self.name, self._rig = source.name, source.rig
        self._reference: SensorFrame | None = None
        self._problem: SourceError | None = None
        try:
            self._reference = source.reference()
        except SourceError as error:
            self._problem = error

    @property
    def rig(self) -> Rig:
        """The rig that took the frames."""
        return self._rig

    def next_frame(self) -> SensorFrame | None:
        """Return nothing: frames are another thread's."""
        return None

    def reference(self) -> SensorFrame | None:
        """Return what the source kept when it was opened."""
        if self._problem is not None:
            raise self._problem
        return self._reference
