"""Reads frames ahead: while one frame is processed, the next is already being read."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor

from ..core.frames import SensorFrame
from ..core.sources.base import FrameSource


class FrameReader:
    """Owns an open source; only its own thread touches it.

    Reading one frame ahead uses a second processor core, for the simulator's noise or for decoding
    images. A frame that was read ahead and is not wanted after all (the person seeks) is dropped.
    """

    def __init__(self, source: FrameSource) -> None:
        self.source = source
        self._thread = ThreadPoolExecutor(1, "reader")
        self._ahead: tuple[int, Future[SensorFrame | None]] | None = None

    def read(self, index: int) -> SensorFrame | None:
        """Return frame ``index`` of a recording, or the next one of a live source; None at the end.

        Raises
        ------
        Exception
            Whatever the source raises.
        """
        ahead, self._ahead = self._ahead, None
        if ahead is not None and ahead[0] == index:
            return ahead[1].result()
        return self._thread.submit(self._read, index).result()

    def read_ahead(self, index: int) -> None:
        """Begin to read a frame of a recording that will probably be wanted next."""
        if self._ahead is None:
            self._ahead = index, self._thread.submit(self._read, index)

    def close(self) -> None:
        """Release the source, after whatever is being read."""
        self._thread.submit(self.source.close)
        self._thread.shutdown(wait=True)

    def _read(self, index: int) -> SensorFrame | None:
        if self.source.length is not None and self.source.position != index:
            self.source.seek(index)
        return self.source.next_frame()
