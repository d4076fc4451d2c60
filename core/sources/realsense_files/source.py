"""RealSense recordings (``.bag``, ``.db3``) of one or two depth cameras, read without the camera driver."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np

from ...errors import SourceError
from ...model.arrays import Float64Array, Uint8Array, Uint16Array
from ...model.files import recording_files, user_path
from ...model.frames import Rig, SensorFrame
from ..base import Health, Progress, SeekableSource, part_of
from ..ros.bags import open_bag
from ..ros_image import DamagedFileError, damage_told, nearest, pairs, period_s
from .bag import BagFile
from .db3 import Db3File
from .recording import Camera, RecordingFile, Stream

_OPENERS: dict[bytes, type[RecordingFile]] = {b"#ROSBAG V2.0\n": BagFile, b"SQLite format 3\x00": Db3File}


class BagSource(SeekableSource):
    """A RealSense recording: one file with one or two depth cameras, or two files with one each.

    The proximity camera is the L515, or the first device where there is none. A frame consists of a proximity and a
    tactile depth image that are mutually nearest in time, at most half a period of the faster camera apart; `health`
    counts the other images. Times are the images' stamps where both cameras use one clock (global or system time),
    else, in one file, the recording times. Each camera's colour image is the one nearest to its depth image. A
    recording does not contain the pose between the cameras: the preset must have it.

    A recording with one depth camera is for viewing only, and `health` says so: the rig's tactile camera is then a
    copy in the same place with the model ``"none"`` and depth 0.
    """

    def __init__(self, name: Path | str, progress: Progress | None = None) -> None:
        self._is_open = True
        self._resources = ExitStack()
        try:
            self._set_up(str(name), progress)
        except BaseException:
            self.close()
            raise

    def _set_up(self, text: str, progress: Progress | None) -> None:
        paths = recording_files(text)
        if not paths:
            raise SourceError(f"bag:{text}: there is no file {user_path(text)}; check the path")
        self._recordings: list[RecordingFile] = []
        for number, path in enumerate(paths):
            recording = open_recording(path, None if progress is None else part_of(progress, number, len(paths)))
            self._resources.callback(recording.close)
            self._recordings.append(recording)
        # PNG and LZ4 take most of a frame's time, and both release the interpreter lock.
        self._helper = ThreadPoolExecutor(1, thread_name_prefix="tactile images")
        self._resources.callback(self._helper.shutdown, cancel_futures=True)
        name = f"bag:{text}"
        cameras = _cameras(name, self._recordings)
        self._proximity, self._tactile = cameras[0], cameras[1] if len(cameras) == 2 else None
        self._color_index = {
            camera: nearest(*_common_times(camera.depth, camera.color, one_device=True))
            for camera in cameras
            if camera.color is not None
        }
        self._unmatched = 0
        if self._tactile is None:
            self._proximity_times_s = self._tactile_times_s = self._proximity.depth.stamps_s
            self._proximity_index = self._tactile_index = np.arange(len(self._proximity_times_s))
        else:
            self._pair(name, self._proximity, self._tactile)
        rig = Rig.of_one_camera(self._proximity.info)
        if self._tactile is not None:
            rig = Rig(
                proximity=self._proximity.info,
                tactile=self._tactile.info,
                proximity_color=self._proximity.calibration.color_camera,
            )
        super().__init__(name, rig, len(self._proximity_index))

    @property
    def frame_rate_hz(self) -> float:
        return self._proximity.depth.rate_hz or super().frame_rate_hz

    def health(self) -> Health:
        lacks = []
        if self._tactile is not None and self._proximity.color is None:
            lacks.append("this recording has no proximity colour: its image stays black")
        lacks += [
            f"{recording.path.name} was not finished when it was recorded: it is shown up to its last whole part"
            for recording in self._recordings
            if not recording.is_complete
        ]
        words = [*lacks, f"{self._unmatched} images without one of the other camera are left out"]
        return Health(ok=not lacks, message="; ".join(words if self._unmatched else lacks), unmatched=self._unmatched)

    def close(self) -> None:
        self._is_open = False
        self._resources.close()

    def read(self, index: int) -> SensorFrame:
        if not self._is_open:
            raise SourceError(f"{self.name} is closed; open it again")
        proximity_index, tactile_index = int(self._proximity_index[index]), int(self._tactile_index[index])
        if self._tactile is None:
            depth, color = self._images(self._proximity, proximity_index)
            if color is not None:
                color = self._proximity.calibration.color_on_depth(color, depth)
            return SensorFrame.of_one_camera(index, depth, color, float(self._proximity_times_s[proximity_index]))
        tactile = self._helper.submit(self._images, self._tactile, tactile_index)
        depth, color = self._images(self._proximity, proximity_index)
        tactile_depth, tactile_color = tactile.result()
        return SensorFrame(
            sequence=index,
            proximity_depth=depth,
            tactile_depth=tactile_depth,
            proximity_color=np.zeros((*depth.shape, 3), np.uint8) if color is None else color,
            tactile_color=tactile_color,
            proximity_time_s=float(self._proximity_times_s[proximity_index]),
            tactile_time_s=float(self._tactile_times_s[tactile_index]),
        )

    def _images(self, camera: Camera, index: int) -> tuple[Uint16Array, Uint8Array | None]:
        """Return a depth image and the colour image nearest to it; that of the tactile camera in depth pixels."""
        depth = camera.image(camera.depth, index)
        if camera.color is None:
            return depth, None
        color = camera.image(camera.color, int(self._color_index[camera][index]))
        return depth, camera.calibration.color_on_depth(color, depth) if camera is self._tactile else color

    def _pair(self, name: str, first: Camera, second: Camera) -> None:
        first_s, second_s = _common_times(first.depth, second.depth, one_device=False)
        if first.path != second.path and first_s is first.depth.recorded_s:
            raise SourceError(
                f"{name}: the cameras' clocks cannot be compared ({first.depth.clock or 'unknown'} and "
                f"{second.depth.clock or 'unknown'}); record both cameras with global time enabled"
            )
        farthest_s = min(period_s(first_s, first.depth.rate_hz), period_s(second_s, second.depth.rate_hz)) / 2
        self._proximity_times_s, self._tactile_times_s = first_s, second_s
        self._proximity_index, self._tactile_index = pairs(first_s, second_s, farthest_s)
        count = len(self._proximity_index)
        if count == 0:
            raise SourceError(
                f"{name}: no image of {first.info.model} has one of {second.info.model} within "
                f"{farthest_s * 1e3:.1f} ms; record both cameras at once"
            )
        self._unmatched = len(first_s) + len(second_s) - 2 * count


def is_realsense(text: str) -> bool:
    """Whether a name is that of librealsense's recordings: two files, or topics that begin with a device's number."""
    paths = recording_files(text)
    if len(paths) != 1:
        return True
    with closing(open_bag(paths[0])) as bag:
        return any(topic.startswith("/device_") for topic in bag.types)


def open_recording(path: Path, progress: Progress | None = None) -> RecordingFile:
    with damage_told(path, "this is no readable RealSense recording"):
        with path.open("rb") as file:
            start = file.read(32)
        # Decided by content, because a .bag may have been renamed.
        opener = next((opener for magic, opener in _OPENERS.items() if start.startswith(magic)), None)
        if opener is None:
            raise DamagedFileError("it begins neither as a .bag nor as a .db3 does" if start else "it is empty")
        opened = opener(path, progress)
        if not opened.cameras:
            opened.close()
            raise DamagedFileError("it holds no depth images")
        return opened


def _cameras(name: str, recordings: list[RecordingFile]) -> list[Camera]:
    """Return the proximity camera and, if there are two, the tactile one."""
    cameras = [camera for recording in recordings for camera in recording.cameras]
    if len(cameras) > 2 or len(cameras) < len(recordings):
        models = ", ".join(camera.info.model for camera in cameras)
        raise SourceError(f"{name} has {len(cameras)} depth cameras ({models}); record one or two")
    first, last = cameras[0].info, cameras[-1].info
    if len(cameras) == 2 and first.serial == last.serial != "":
        raise SourceError(
            f"{name}: both recordings are of the same camera, {first.model} {first.serial}; "
            "give the recording of the other camera as well"
        )
    return sorted(cameras, key=lambda camera: "L515" not in camera.info.model)


def _common_times(first: Stream, second: Stream, *, one_device: bool) -> tuple[Float64Array, Float64Array]:
    """Return both streams' own stamps in seconds if these are on one clock, else when they were recorded.

    A camera's own clock counts for that camera alone.
    """
    if first.clock == second.clock != "" and (one_device or first.clock != "Hardware Clock"):
        return first.stamps_s, second.stamps_s
    return first.recorded_s, second.recorded_s
