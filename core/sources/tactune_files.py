"""Plays recordings in MCAP: Tactune's own bit for bit, and copies that ROS tools made of them."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np

from ..errors import FrameError, PresetError, SourceError
from ..model.arrays import AnyArray, Float64Array
from ..model.files import recording_files, user_path
from ..model.frames import DepthCamera, GroundTruth, Rig, SensorFrame, Shot
from ..model.loading import frame_from_bytes, parse_json
from ..model.rig_file import parse_rig
from ..preset import Preset
from ..preset.file import preset_and_note
from .base import Progress
from .cameras.camera import Calibration
from .cameras.pairing import nearest_within, period_s
from .recorded import RecordedCamera, RecordedSource
from .ros.mcap import McapBag
from .ros.messages import FORMAT_VERSION, METADATA_NAME, PRESET_NAME, RIG_NAME, UNTOUCHED_NAME, Topic
from .ros_image import RawImage, damage_told

#: How the images of each topic are read, from a message and the shape (H, W) that the rig states.
_IMAGES: Final[dict[Topic, Callable[[RawImage, tuple[int, int]], AnyArray]]] = {
    Topic.PROXIMITY_DEPTH: RawImage.counts,
    Topic.PROXIMITY_COLOR: RawImage.color,
    Topic.TACTILE_DEPTH: RawImage.counts,
    Topic.TACTILE_COLOR: RawImage.color,
    Topic.TRUTH_CONTACT: lambda image, shape: image.channel(shape, ("mono8",), np.dtype(np.uint8)),
    Topic.TRUTH_DEPTH: lambda image, shape: image.channel(shape, ("32FC1",), np.dtype(np.float32)),
}
#: What belongs to a frame beside the images of its cameras.
_BESIDE: Final = (Topic.FRAME, Topic.TRUTH_CONTACT, Topic.TRUTH_DEPTH)


class McapSource(RecordedSource):
    """A recording in MCAP, with one frame for each proximity depth image.

    Recordings of `SessionWriter` are read bit for bit. One that was cut off plays up to its last complete chunk, and
    `health` says so. In a bag that was recorded again while it played, a frame consists of images whose header stamps
    are at most half a period apart; the others are counted.
    """

    def __init__(self, path: Path | str, progress: Progress | None = None) -> None:
        name = f"mcap:{path}"
        self._path = user_path(path)
        if not self._path.is_file():
            raise SourceError(f"{name}: there is no file {self._path}; check the path")
        with ExitStack() as resources:
            self._bag = McapBag(self._path, progress)
            resources.callback(self._bag.close)
            self._check_topic(Topic.TACTILE_DEPTH)
            self._about = self._bag.metadata.get(METADATA_NAME, {})
            version = self._about.get("format_version", str(FORMAT_VERSION))
            if version != str(FORMAT_VERSION):
                raise SourceError(f"{self._path} has the format version {version}; open it with a newer Tactune")
            rig = self._read_rig()
            if rig.has_proximity:
                self._check_topic(Topic.PROXIMITY_DEPTH)
            super().__init__(name, self._cameras_of(rig), resources, rig=rig)
            if not self._bag.complete:
                cut = f"this recording was cut off; it plays up to its last complete frame, number {self.length - 1}"
                self._lacks.insert(0, cut)
            self.read(0)
            self._resources = resources.pop_all()

    def preset(self) -> Preset | None:
        """Return the recorded preset, or None; a warning of the logger ``tactune`` names fields that are gone."""
        found = self.preset_text()
        if found is None:
            return None
        preset, note = preset_and_note(*found)
        if note:
            logging.getLogger(__name__).warning("%s: %s", found[1], note)
        return preset

    def preset_text(self) -> tuple[str, str] | None:
        """Return the text of the preset and what messages call it, or None if there is none."""
        try:
            data = self._bag.attachment(PRESET_NAME)
        except SourceError as error:
            raise PresetError(str(error)) from error
        return None if data is None else (data.decode(errors="replace"), f"{PRESET_NAME} in {self._path}")

    def untouched(self) -> SensorFrame | None:
        data = self._bag.attachment(UNTOUCHED_NAME)
        try:
            return None if data is None else frame_from_bytes(data)
        except FrameError as error:
            raise SourceError(f"{self._path}: its untouched frame is damaged ({error}); capture it again") from error

    def _frame(self, index: int, proximity: Shot | None, tactile: Shot) -> SensorFrame:
        """Return a frame with what is recorded beside its images: its number, its times and the truth."""
        rig, sequence, truth = self.rig, index, None
        number, *of_truth = (int(numbers[self._first[index]]) for numbers in self._beside)
        if number >= 0:
            sequence, time_s, tactile_time_s = self._frame_record(number)
            tactile = tactile._replace(time_s=tactile_time_s)
            proximity = None if proximity is None else proximity._replace(time_s=time_s)
        if of_truth[0] >= 0:
            shape = rig.proximity.intrinsics.shape
            with damage_told(self._path, f"the truth of frame {index} cannot be read"):
                contact = self._image(Topic.TRUTH_CONTACT, shape, of_truth[0])
                depth_m = self._image(Topic.TRUTH_DEPTH, shape, of_truth[1]) if of_truth[1] >= 0 else None
            truth = GroundTruth(contact != 0, depth_m)
        return SensorFrame.of_shots(rig, sequence, proximity, tactile, truth)

    def _check_topic(self, needed: Topic) -> None:
        if not self._bag.count(needed):
            kinds = self._bag.kinds
            known = f"its topics are {', '.join(sorted(kinds)[:8])}" if kinds else "it has no messages"
            cut = "" if self._bag.complete else "it was cut off before its first frame was complete; "
            why = f"{cut}no image is on {needed} ({known}); choose another"
            if Topic.PATCH in kinds:
                why = "it holds contact patches only, for Foxglove or RViz; record images with tactune record"
            raise SourceError(f"{self._path} holds no frame: {why}")

    def _cameras_of(self, rig: Rig) -> list[RecordedCamera]:
        """Return the cameras, with log times where each frame has one of its own, else with stamps, seconds."""
        near = Topic.PROXIMITY_DEPTH if rig.has_proximity else Topic.TACTILE_DEPTH
        log_ns = self._bag.times_ns(near)
        is_exact = bool(np.isin(log_ns, self._bag.times_ns(Topic.FRAME)).all())

        def times_s(topic: Topic) -> Float64Array:
            if is_exact:
                return np.asarray((self._bag.times_ns(topic) - log_ns[0]) * 1e-9, np.float64)
            if topic == Topic.FRAME:
                records = map(self._frame_record, range(self._bag.count(topic)))
                return np.array([time_s for _, time_s, _ in records], np.float64)
            return self._bag.stamps_s(topic)

        first, second = times_s(near), times_s(Topic.TACTILE_DEPTH)
        farthest_s = 0.0 if is_exact else min(period_s(first), period_s(second)) / 2
        self._beside = [nearest_within(first, times_s(topic), farthest_s) for topic in _BESIDE]
        rate_hz = self._rate_hz(first)

        def camera(lens: DepthCamera, depth: Topic, color: Topic, color_shape: tuple[int, int]) -> RecordedCamera:
            times = first if depth == near else second
            read_color = partial(self._image, color, color_shape) if self._bag.count(color) else None
            partners = nearest_within(times, times_s(color), farthest_s)
            read_depth = partial(self._image, depth, lens.intrinsics.shape)
            return RecordedCamera(self._path, Calibration(lens), rate_hz, times, read_depth, read_color, partners)

        tactile = camera(rig.tactile, Topic.TACTILE_DEPTH, Topic.TACTILE_COLOR, rig.tactile.intrinsics.shape)
        if not rig.has_proximity:
            return [tactile]
        shape = rig.proximity_color_shape
        return [camera(rig.proximity, Topic.PROXIMITY_DEPTH, Topic.PROXIMITY_COLOR, shape), tactile]

    def _rate_hz(self, times_s: Float64Array) -> float:
        """Return the rate in the recording's metadata, or else that of its times; 0 for a single frame."""
        with suppress(KeyError, ValueError):
            if 0.0 < (named_hz := float(self._about["frame_rate_hz"])) < math.inf:
                return named_hz
        return 1 / period_s(times_s) if len(times_s) > 1 else 0.0

    def _read_rig(self) -> Rig:
        data = self._bag.attachment(RIG_NAME)
        with damage_told(self._path, f"{RIG_NAME} is no JSON object"):
            if data is None and self._bag.count(Topic.RIG):
                data = self._bag.message(Topic.RIG, 0).data
            if data is None:
                told = "write its images to a folder and describe the cameras with tactune preset create-rig"
                raise SourceError(f"{self._path} has no {RIG_NAME} and no {Topic.RIG}: {told}")
            return parse_rig(dict(parse_json(data)), f"{RIG_NAME} in {self._path}")

    def _frame_record(self, number: int) -> tuple[int, float, float]:
        with damage_told(self._path, f"a message of {Topic.FRAME} is damaged"):
            data = parse_json(self._bag.message(Topic.FRAME, number).data)
            return int(data["sequence"]), float(data["proximity_time_s"]), float(data["tactile_time_s"])

    def _image(self, topic: Topic, shape: tuple[int, int], number: int) -> AnyArray:
        return _IMAGES[topic](RawImage.of(self._bag.message(topic, number)), shape)


def is_ours(text: str) -> bool:
    """Whether a file of this name says its rig, as Tactune's recordings and copies of them do."""
    paths = recording_files(text)
    if len(paths) != 1:
        return not paths  # it is told that there is none
    with closing(McapBag(paths[0])) as bag:
        return bag.attachment(RIG_NAME) is not None or Topic.RIG in bag.kinds or not bag.kinds
