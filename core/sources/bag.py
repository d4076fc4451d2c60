"""RealSense recordings (ROS 1 ``.bag``) with one or two depth cameras, read without the camera driver."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from ..clouds import deproject, valid_depth
from ..errors import SourceError
from ..frames import ColorCamera, Rig, SensorFrame, rigid_transform
from ..masking import colors_at
from ..paths import user_path
from .bag_reader import Camera, RealSenseBag, Stream
from .base import Health, Progress, SeekableSource

Float64Array = npt.NDArray[np.float64]
_IDENTITY = rigid_transform(np.eye(4))
_HARDWARE_CLOCK = "Hardware Clock"


class BagSource(SeekableSource):
    """A RealSense recording, with one frame for each proximity depth image.

    The proximity camera is the L515, or the first device where none is called so. Every other image
    is the nearest in time: by the images' own time stamps where both are on one clock, else by the
    moments at which they were recorded. How the two cameras stand to each other is not in a
    recording, so the rig has no pose and the preset must bring it.

    With one depth camera the recording is for viewing only, and `health` says so: the rig's tactile
    camera is a copy in the same place with the model ``"none"``, its depth is 0 everywhere.

    Parameters
    ----------
    path : path of the ``.bag`` file
    progress : callable, optional
        Told the share of the images that are indexed, and what is being done.

    Raises
    ------
    SourceError
        No such file, damaged, or not such a recording; the message says which and what to do.
    """

    def __init__(self, path: Path | str, progress: Progress | None = None) -> None:
        name = f"bag:{path}"
        file = user_path(path)
        if not file.is_file():
            raise SourceError(f"{name}: there is no file {file}; check the path")
        self._bag = RealSenseBag(file, progress)
        if len(self._bag.cameras) > 2:
            models = ", ".join(camera.info.model for camera in self._bag.cameras)
            self._bag.close()
            raise SourceError(f"{name} has {len(self._bag.cameras)} depth cameras ({models}); record one or two")
        cameras = sorted(self._bag.cameras, key=lambda camera: "L515" not in camera.info.model)
        self._proximity, self._tactile = cameras[0], cameras[1] if len(cameras) > 1 else None
        super().__init__(name, _rig(self._proximity, self._tactile), len(self._proximity.depth))

        depth, other = self._proximity.depth, self._tactile.depth if self._tactile else self._proximity.depth
        self._proximity_times_s, self._tactile_times_s = _times(depth, other)
        self._tactile_index = _nearest(self._proximity_times_s, self._tactile_times_s)
        self._color_index = {
            camera: _nearest(*_times(camera.depth, camera.color)) for camera in cameras if camera.color is not None
        }

    @property
    def frame_rate_hz(self) -> float:
        """The nominal rate of the proximity depth stream."""
        return self._proximity.depth.rate_hz or super().frame_rate_hz

    def health(self) -> Health:
        """Say what the recording lacks."""
        lacks = []
        if self._tactile is None:
            lacks.append("this recording has one depth camera: for viewing only")
        if self._proximity.color is None:
            lacks.append("this recording has no proximity colour: its image stays black")
        return Health(ok=not lacks, message="; ".join(lacks))

    def close(self) -> None:
        """Close the file."""
        self._bag.close()

    def read(self, index: int) -> SensorFrame:
        """Read frame ``index`` from the file."""
        depth = self._bag.depth_image(self._proximity.depth, index)
        tactile_index = int(self._tactile_index[index])
        if self._tactile is None:
            tactile_depth, tactile_color = np.zeros_like(depth), None
        else:
            tactile_depth = self._bag.depth_image(self._tactile.depth, tactile_index)
            tactile_color = self._color(self._tactile, tactile_index)
            if tactile_color is not None:
                tactile_color = _color_on_depth(tactile_color, tactile_depth, self._tactile)
        proximity_color = self._color(self._proximity, index)
        return SensorFrame(
            sequence=index,
            proximity_depth=depth,
            tactile_depth=tactile_depth,
            proximity_color=np.zeros((*depth.shape, 3), np.uint8) if proximity_color is None else proximity_color,
            tactile_color=tactile_color,
            proximity_time_s=float(self._proximity_times_s[index]),
            tactile_time_s=float(self._tactile_times_s[tactile_index]),
        )

    def _color(self, camera: Camera, depth_index: int) -> npt.NDArray[np.uint8] | None:
        """Return the colour image nearest to a depth image of the same camera."""
        if camera.color is None:
            return None
        return self._bag.color_image(camera.color, int(self._color_index[camera][depth_index]))


def _rig(proximity: Camera, tactile: Camera | None) -> Rig:
    color = None
    if proximity.color is not None and not proximity.color_is_aligned:
        color = ColorCamera(intrinsics=proximity.color.intrinsics, T_color_depth=proximity.T_color_depth)
    if tactile is None:
        nobody = proximity.info.model_copy(update={"model": "none", "serial": ""})
        return Rig(proximity=proximity.info, tactile=nobody, proximity_color=color, T_proximity_tactile=_IDENTITY)
    return Rig(proximity=proximity.info, tactile=tactile.info, proximity_color=color)


def _times(first: Stream, second: Stream) -> tuple[Float64Array, Float64Array]:
    """Return both streams' times in seconds on one clock, the most exact that they share."""
    same_clock = first.clock == second.clock != ""
    if same_clock and (first.device == second.device or first.clock != _HARDWARE_CLOCK):
        return first.stamps_s, second.stamps_s
    return first.recorded_s, second.recorded_s


def _nearest(times_s: Float64Array, candidates_s: Float64Array) -> npt.NDArray[np.intp]:
    """Return for each time the index of the nearest candidate; the earlier of two that are as near."""
    order = np.argsort(candidates_s, kind="stable")
    ordered = candidates_s[order]
    after = np.searchsorted(ordered, times_s).clip(1, max(len(ordered) - 1, 1))
    before = after - 1
    after = after.clip(max=len(ordered) - 1)
    later_is_nearer = ordered[after] - times_s < times_s - ordered[before]
    return order[np.where(later_is_nearer, after, before)]


def _color_on_depth(
    color: npt.NDArray[np.uint8], depth: npt.NDArray[np.uint16], camera: Camera
) -> npt.NDArray[np.uint8]:
    """Bring a camera's colour image to its depth pixels; black where there is no depth or no colour."""
    if camera.color_is_aligned:
        return color
    pixels = np.flatnonzero(valid_depth(depth))
    points = deproject(depth, camera.info, pixels)
    aligned = np.zeros((*depth.shape, 3), np.uint8)
    aligned.reshape(-1, 3)[pixels], _ = colors_at(points, pixels, color, _rig(camera, None))
    return aligned
