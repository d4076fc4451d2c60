"""RealSense recordings (``.bag``, ``.db3``) of one or two depth cameras, read without the camera driver."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from ...errors import SourceError
from ...model.arrays import Float64Array, IndexArray, Uint8Array, Uint16Array
from ...model.files import recording_files, user_path
from ...model.frames import Rig, SensorFrame, rigid_transform
from ..base import Health, Progress, SeekableSource, part_of
from ..ros_image import DamagedFileError
from .bag import BagFile
from .db3 import Db3File
from .recording import HARDWARE_CLOCK, Camera, RecordingFile, Stream, damage_told

#: Seconds in this range are a date; smaller ones count from an arbitrary start.
_FIRST_DATE_S = 1e9
_LAST_DATE_S = 1e11
_OPENERS: dict[bytes, type[BagFile | Db3File]] = {b"#ROSBAG V2.0\n": BagFile, b"SQLite format 3\x00": Db3File}
_IDENTITY = rigid_transform(np.eye(4))


class BagSource(SeekableSource):
    """A RealSense recording: one file with one or two depth cameras, or two files with one each.

    The proximity camera is the L515, or the first device where there is none. A frame consists of a proximity and a
    tactile depth image that are mutually nearest in time, at most half a period of the faster camera apart; `health`
    counts the other images. Times are the images' stamps where both cameras use one clock (global or system time),
    else the recording times or, for two files, the times of arrival at the computer. Each camera's colour image is the
    one nearest to its depth image. A recording does not contain the pose between the cameras: the preset must have it.

    A recording with one depth camera is for viewing only, and `health` says so: the rig's tactile camera is then a
    copy in the same place with the model ``"none"`` and depth 0.
    """

    def __init__(self, name: Path | str, progress: Progress | None = None) -> None:
        recordings = open_recordings(str(name), progress)
        try:
            self._set_up(f"bag:{name}", recordings)
        except BaseException:
            for recording in recordings:
                recording.close()
            raise

    def _set_up(self, name: str, recordings: list[RecordingFile]) -> None:
        self._recordings = recordings
        self._is_open = True
        # PNG and LZ4 take most of a frame's time, and both release the interpreter lock.
        self._helper = ThreadPoolExecutor(1, thread_name_prefix="tactile images")
        self._proximity, self._tactile = _roles(name, recordings)
        self._cameras = [self._proximity] if self._tactile is None else [self._proximity, self._tactile]
        self._unmatched, self._unmatched_words = 0, ""
        if self._tactile is None:
            self._proximity_times_s = self._tactile_times_s = self._proximity.depth.stamps_s
            self._proximity_index = self._tactile_index = np.arange(len(self._proximity.depth))
        else:
            self._pair(name, self._tactile)
        self._color_index = {camera: _color_index(camera) for camera in self._cameras if camera.color is not None}
        super().__init__(name, _rig(self._proximity, self._tactile), len(self._proximity_index))

    @property
    def frame_rate_hz(self) -> float:
        """The nominal rate of the proximity depth stream."""
        return self._proximity.depth.rate_hz or super().frame_rate_hz

    def health(self) -> Health:
        """Return what the recording lacks."""
        lacks = []
        if self._tactile is None:
            lacks.append("this recording has one depth camera: for viewing only")
        if self._proximity.color is None:
            lacks.append("this recording has no proximity colour: its image stays black")
        lacks += [
            f"{recording.path.name} was not finished when it was recorded: it is shown up to its last whole part"
            for recording in self._recordings
            if not recording.is_complete
        ]
        words = [*lacks, self._unmatched_words] if self._unmatched_words else lacks
        return Health(ok=not lacks, message="; ".join(words), unmatched=self._unmatched)

    def close(self) -> None:
        """Close the files."""
        self._is_open = False
        self._helper.shutdown(cancel_futures=True)
        for recording in self._recordings:
            recording.close()

    def read(self, index: int) -> SensorFrame:
        """Read frame ``index`` from the files."""
        if not self._is_open:
            raise SourceError(f"{self.name} is closed; open it again")
        proximity_index, tactile_index = int(self._proximity_index[index]), int(self._tactile_index[index])
        tactile = self._helper.submit(self._read_tactile, tactile_index) if self._tactile else None
        depth = self._proximity.depth_image(proximity_index)
        proximity_color = self._color(self._proximity, proximity_index)
        tactile_depth, tactile_color = tactile.result() if tactile else (np.zeros_like(depth), None)
        return SensorFrame(
            sequence=index,
            proximity_depth=depth,
            tactile_depth=tactile_depth,
            proximity_color=np.zeros((*depth.shape, 3), np.uint8) if proximity_color is None else proximity_color,
            tactile_color=tactile_color,
            proximity_time_s=float(self._proximity_times_s[proximity_index]),
            tactile_time_s=float(self._tactile_times_s[tactile_index]),
        )

    def _read_tactile(self, index: int) -> tuple[Uint16Array, Uint8Array | None]:
        """Return a tactile depth image and its colours in depth pixels."""
        assert self._tactile is not None
        depth = self._tactile.depth_image(index)
        color = self._color(self._tactile, index)
        return depth, color if color is None else self._tactile.calibration.color_on_depth(color, depth)

    def _color(self, camera: Camera, depth_index: int) -> Uint8Array | None:
        """Return the colour image nearest to a depth image of the same camera."""
        if camera.color is None:
            return None
        return camera.color_image(int(self._color_index[camera][depth_index]))

    def _pair(self, name: str, tactile: Camera) -> None:
        """Pair the depth images; raise `SourceError` if no pair is found."""
        first, second = self._proximity, tactile
        times = common_times(first.depth, second.depth, same_recording=first.path == second.path, same_device=False)
        if times is None:
            raise SourceError(
                f"{name}: the cameras' clocks cannot be compared ({_clock(first)} and {_clock(second)}, and not both "
                "files say when images arrived); record both cameras with global time enabled"
            )
        first_s, second_s = times
        if first_s.max() < second_s.min() or second_s.max() < first_s.min():
            raise SourceError(
                f"{name}: the two cameras were not recorded at the same time: {first.info.model} from "
                f"{span_text(first_s)}, {second.info.model} from {span_text(second_s)}; "
                "give two recordings of the same moment"
            )
        farthest_s = min(period_s(first_s, first.depth.rate_hz), period_s(second_s, second.depth.rate_hz)) / 2
        self._proximity_times_s, self._tactile_times_s = times
        self._proximity_index, self._tactile_index = pairs(first_s, second_s, farthest_s)
        count = len(self._proximity_index)
        if count == 0:
            raise SourceError(
                f"{name}: no image of {first.info.model} has one of {second.info.model} within "
                f"{farthest_s * 1e3:.1f} ms; record both cameras at once"
            )
        alone = len(first_s) - count, len(second_s) - count
        self._unmatched = sum(alone)
        if self._unmatched:
            self._unmatched_words = (
                f"left out because the other camera has no image within {farthest_s * 1e3:.1f} ms: "
                f"{alone[0]} of {len(first_s)} proximity and {alone[1]} of {len(second_s)} tactile images"
            )


def _roles(name: str, recordings: list[RecordingFile]) -> tuple[Camera, Camera | None]:
    """Return the proximity and the tactile camera; the latter is None if there is only one."""
    cameras = [camera for recording in recordings for camera in recording.cameras]
    models = ", ".join(camera.info.model for camera in cameras)
    if len(recordings) == 2 and len(cameras) != 2:
        raise SourceError(
            f"{name}: the two files have {len(cameras)} depth cameras ({models}); give files with one camera each"
        )
    if len(cameras) > 2:
        raise SourceError(f"{name} has {len(cameras)} depth cameras ({models}); record one or two")
    if len(cameras) == 2 and cameras[0].info.serial == cameras[1].info.serial != "":
        raise SourceError(
            f"{name}: both recordings are of the same camera, {cameras[0].info.model} {cameras[0].info.serial}; "
            "give the recording of the other camera as well"
        )
    cameras.sort(key=lambda camera: "L515" not in camera.info.model)
    return cameras[0], cameras[1] if len(cameras) == 2 else None


def _clock(camera: Camera) -> str:
    return f"{camera.info.model}: {camera.depth.clock or 'unknown'}"


def _rig(proximity: Camera, tactile: Camera | None) -> Rig:
    color = proximity.calibration.color_camera
    if tactile is None:
        nobody = proximity.info.model_copy(update={"model": "none", "serial": ""})
        return Rig(proximity=proximity.info, tactile=nobody, proximity_color=color, T_proximity_tactile=_IDENTITY)
    return Rig(proximity=proximity.info, tactile=tactile.info, proximity_color=color)


def _color_index(camera: Camera) -> IndexArray:
    """Return for each depth image of a camera the index of its colour image."""
    assert camera.color is not None
    times = common_times(camera.depth, camera.color, same_recording=True, same_device=True)
    assert times is not None
    return nearest(*times)


def common_times(
    first: Stream, second: Stream, *, same_recording: bool, same_device: bool
) -> tuple[Float64Array, Float64Array] | None:
    """Return both streams' times in seconds on the most exact clock that they share.

    That is the clock of the images' own stamps where both name the same (a camera's own clock counts
    for that camera alone), else when the images were recorded or, across two recordings, when they
    reached the computer. None if no clock is shared.
    """
    if first.clock == second.clock != "" and (same_device or first.clock != HARDWARE_CLOCK):
        return first.stamps_s, second.stamps_s
    if same_recording:
        return first.recorded_s, second.recorded_s
    if first.arrived_s is not None and second.arrived_s is not None:
        return first.arrived_s, second.arrived_s
    return None


def period_s(times_s: Float64Array, rate_hz: float) -> float:
    """Return the median time between two images, seconds; with a single image, that of the nominal rate."""
    usual = float(np.median(np.diff(np.sort(times_s)))) if len(times_s) > 1 else 0.0
    return usual or 1.0 / (rate_hz if rate_hz > 0 else 30.0)


def nearest(times_s: Float64Array, candidates_s: Float64Array) -> IndexArray:
    """Return for each time the index of the nearest candidate; the earlier of two that are as near."""
    order = np.argsort(candidates_s, kind="stable")
    ordered = candidates_s[order]
    after = np.searchsorted(ordered, times_s).clip(1, max(len(ordered) - 1, 1))
    before = after - 1
    after = after.clip(max=len(ordered) - 1)
    later_is_nearer = ordered[after] - times_s < times_s - ordered[before]
    return order[np.where(later_is_nearer, after, before)]


def pairs(first_s: Float64Array, second_s: Float64Array, farthest_s: float) -> tuple[IndexArray, IndexArray]:
    """Return the indices of images that are each other's nearest and at most ``farthest_s`` apart."""
    partner = nearest(first_s, second_s)
    is_mutual = nearest(second_s, first_s)[partner] == np.arange(len(first_s))
    # Stamps are sums and products of decimal fractions: exactly half a period must still count.
    is_near = np.abs(second_s[partner] - first_s) <= farthest_s * (1 + 1e-6)
    chosen = np.flatnonzero(is_mutual & is_near)
    return chosen, partner[chosen]


def span_text(times_s: Float64Array) -> str:
    """Return the time range of images as text."""
    return f"{_moment(float(times_s.min()))} to {_moment(float(times_s.max()))}"


def _moment(time_s: float) -> str:
    if _FIRST_DATE_S < time_s < _LAST_DATE_S:
        return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%d %H:%M:%S.%f}"[:-3] + " UTC"
    return f"{time_s:.3f} s"


def open_recordings(text: str, progress: Progress | None) -> list[RecordingFile]:
    """Open one recording, or two whose paths are separated by a comma."""
    paths = recording_files(text)
    if not paths:
        raise SourceError(f"bag:{text}: there is no file {_missing(text)}; check the path")
    opened: list[RecordingFile] = []
    try:
        for number, path in enumerate(paths):
            within = None if progress is None else part_of(progress, number, len(paths))
            opened.append(_open(path, within))
    except BaseException:
        for recording in opened:
            recording.close()
        raise
    return opened


def _open(path: Path, progress: Progress | None) -> RecordingFile:
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


def _missing(text: str) -> str:
    """Return the part of a name that is not a file."""
    parts = [user_path(part) for part in text.split(",")]
    if len(parts) != 2:
        return str(user_path(text))
    return str(next((part for part in parts if not part.is_file()), user_path(text)))
