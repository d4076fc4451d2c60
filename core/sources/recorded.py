"""What recordings have in common: cameras, and frames of images that belong together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import SourceError
from ..model.arrays import Float64Array, IndexArray, Uint8Array, Uint16Array
from ..model.frames import Matrix4, Rig, SensorFrame, Shot
from .base import Health, SeekableSource, from_first_s
from .cameras.camera import Calibration
from .cameras.pairing import pairs, period_s
from .ros_image import damage_told


@dataclass(frozen=True, eq=False)
class RecordedCamera:
    """One camera of a recording at ``path``.

    ``depth`` reads counts, uint16 (H, W), by their number in ``times_s``, ``color`` RGB, uint8 (H, W, 3), by the number
    in ``partners``, which is -1 for a depth image without colour.
    """

    path: Path
    calibration: Calibration
    rate_hz: float
    times_s: Float64Array
    depth: Callable[[int], Uint16Array]
    color: Callable[[int], Uint8Array] | None
    partners: IndexArray

    def shot(self, index: int, *, on_depth: bool) -> Shot:
        """Return a depth image and its colour, if wanted in the pixels of the depth."""
        with damage_told(self.path, f"depth image {index} or its colour cannot be read"):
            depth, color = self.depth(index), None
            if self.color is not None and self.partners[index] >= 0:
                color = self.color(int(self.partners[index]))
                color = self.calibration.color_on_depth(color, depth) if on_depth else color
            return Shot(depth, color, float(self.times_s[index]))


class RecordedSource(SeekableSource):
    """One or two cameras of a recording; images of two are paired by time, at most half a period apart.

    The first camera of two is the proximity camera. ``lacks`` are clauses about what the recording lacks; ``resources``
    are closed with the source; ``rig`` is that of the cameras, if the recording states it.
    """

    def __init__(
        self,
        name: str,
        cameras: Sequence[RecordedCamera],
        resources: ExitStack,
        lacks: Sequence[str] = (),
        T_proximity_tactile: Matrix4 | None = None,
        rig: Rig | None = None,
    ) -> None:
        self._cameras, self._resources, self._lacks = cameras, resources, list(lacks)
        self._is_open = True
        self._unmatched = 0
        # PNG and LZ4 take most of a frame's time, and both release the interpreter lock.
        self._helper = ThreadPoolExecutor(1, thread_name_prefix="tactile images")
        resources.callback(self._helper.shutdown, cancel_futures=True)
        first, last = cameras[0], cameras[-1]
        if len(cameras) == 1:
            rig = rig or Rig.of_one_camera(first.calibration.depth)
            self._first = self._second = np.argsort(first.times_s, kind="stable")
        else:
            rig = rig or Rig(
                proximity=first.calibration.depth,
                tactile=last.calibration.depth,
                proximity_color=first.calibration.color_camera,
                T_proximity_tactile=T_proximity_tactile,
            )
            self._pair(name, first, last)
            if first.color is None:
                self._lacks.append("this recording has no proximity colour: its image stays black")
        super().__init__(name, rig, len(self._first))
        self.frame_rate_hz = first.rate_hz or self.frame_rate_hz

    def _pair(self, name: str, first: RecordedCamera, second: RecordedCamera) -> None:
        farthest_s = min(period_s(each.times_s, each.rate_hz) for each in (first, second)) / 2
        self._first, self._second = pairs(first.times_s, second.times_s, farthest_s)
        self._unmatched = len(first.times_s) + len(second.times_s) - 2 * len(self._first)
        if not len(self._first):
            apart_s = abs(float(np.median(first.times_s) - np.median(second.times_s)))
            raise SourceError(
                f"{name}: no depth image of {first.calibration.depth.model} has one of "
                f"{second.calibration.depth.model} within {farthest_s * 1e3:.1f} ms by their stamps, which are about "
                f"{apart_s:.3g} s apart; choose recordings of the same time, or shift one's stamps if only the clocks "
                "differ"
            )

    def times_s(self) -> Float64Array | None:
        return from_first_s(self._cameras[0].times_s[self._first])

    def health(self) -> Health:
        said = list(self._lacks)
        if self._unmatched:
            said.append(f"{self._unmatched} images without a partner from the other camera are left out")
        return Health(ok=not self._lacks, message="; ".join(said), unmatched=self._unmatched)

    def close(self) -> None:
        self._is_open = False
        self._resources.close()

    def read(self, index: int) -> SensorFrame:
        if not self._is_open:
            raise SourceError(f"{self.name} is closed; open it again")
        proximity, tactile = self._cameras[0], self._cameras[-1]
        first, second = int(self._first[index]), int(self._second[index])
        if not self.rig.has_proximity:
            return self._frame(index, None, tactile.shot(second, on_depth=True))
        waiting = self._helper.submit(tactile.shot, second, on_depth=True)
        shot = proximity.shot(first, on_depth=False)
        return self._frame(index, shot, waiting.result())

    def _frame(self, index: int, proximity: Shot | None, tactile: Shot) -> SensorFrame:
        return SensorFrame.of_shots(self.rig, index, proximity, tactile)
