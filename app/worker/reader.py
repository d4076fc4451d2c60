"""Reads recordings ahead: while one frame is processed, the next is already being read."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

from ...core.model.frames import SensorFrame
from ...core.sources.base import FrameSource


class FrameReader:
    """Owns an open recording; only its own thread touches it.

    Reading one frame ahead uses a second processor core, for the simulator's noise or for decoding
    images. A frame that was read ahead and is not wanted after all (the person seeks) is dropped.
    """

    def __init__(self, source: FrameSource) -> None:
        self.source = source
        self._thread = ThreadPoolExecutor(1, "reader")
        self._ahead: tuple[int, Future[SensorFrame | None]] | None = None

    def read(self, index: int) -> SensorFrame | None:
        """Return frame ``index`` of a recording; None at the end.

        Raises
        ------
        Exception
            Whatever the source raises.
        """
        ahead, self._ahead = self._ahead, None
        if ahead is not None and ahead[0] == index:
            return ahead[1].result()
        return self._thread.submit(self._read, index).result()

    def read_ahead(self, index: int | None) -> None:
        """Begin to read a frame that will probably be wanted next; what goes wrong appears when it is."""
        if self._ahead is None and index is not None:
            self._ahead = index, self._thread.submit(self._read, index)

    def reference(self) -> SensorFrame | None:
        """Return a frame of the untouched membrane, or None where the recording has none."""
        return self._thread.submit(self.source.reference).result()

    def close(self) -> None:
        """Release the source, after whatever is being read."""
        self._thread.submit(self.source.close)
        self._thread.shutdown(wait=True)

    def _read(self, index: int) -> SensorFrame | None:
        if self.source.position != index:
            self.source.seek(index)
        return self.source.next_frame()
