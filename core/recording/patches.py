"""Contact patches as a ROS 2 bag of point clouds."""

from __future__ import annotations

from pathlib import Path
from types import TracebackType
from typing import Self

from ..model.arrays import Float32Array
from ..model.frames import Rig
from ..preset import Preset
from ..sources.mcap.container import Message
from ..sources.mcap.messages import POINT_CLOUD, LogClock, Topic, nanoseconds, point_cloud
from .bag import Bag


class PatchWriter:
    """Writes patches on the topic ``/contact/patch``, with the rig and the preset in the file.

    A context manager that finishes the file, also after an error; without a patch it removes it.

    Parameters
    ----------
    path : path of the new file
    rig : Rig
    preset : Preset
    frame_rate_hz : float

    Raises
    ------
    ExportError
        There is such a file already, or it cannot be written.
    """

    def __init__(self, path: Path | str, rig: Rig, preset: Preset, frame_rate_hz: float) -> None:
        self._clock = LogClock(1.0 / frame_rate_hz)
        self._bag = Bag(path, {Topic.PATCH: POINT_CLOUD}, rig, preset, frame_rate_hz)

    def write(self, points: Float32Array, sequence: int, time_s: float) -> None:
        """Write one patch.

        Parameters
        ----------
        points : float32, shape (N, 3)
            Metres in the proximity camera's depth frame; none make an empty cloud.
        sequence : int
            Number of its frame.
        time_s : float
            The proximity time stamp of its frame.

        Raises
        ------
        ExportError
            The operating system refuses; the patches before stay readable.
        """
        stamp_ns = nanoseconds(time_s)
        cloud = point_cloud(points, stamp_ns)
        log_ns = self._clock.tick(stamp_ns)
        self._bag.write([Message(self._bag.channel(Topic.PATCH), sequence, log_ns, max(stamp_ns, 0), (cloud,))])

    def close(self) -> None:
        """Finish the file; twice is harmless."""
        self._bag.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
