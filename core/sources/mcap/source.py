"""Plays recordings in MCAP: Tactune's own bit for bit, and copies that ROS tools made of them."""

from __future__ import annotations

import logging
import math
import struct
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import PresetError, SourceError
from ...model.arrays import AnyArray, Float64Array, IndexArray, Int64Array, Uint64Array
from ...model.files import recording_files, user_path
from ...model.frames import GroundTruth, Rig, SensorFrame, Shot
from ...model.loading import parse_json, parse_untouched
from ...model.rig_file import parse_rig
from ...preset import Preset
from ...preset.file import preset_and_note
from ..base import Health, Progress, SeekableSource
from ..cameras.pairing import nearest, nearest_within, pairs, period_s
from ..ros_image import DamagedFileError, RawImage
from .messages import (
    FORMAT_VERSION,
    IMAGE,
    METADATA_NAME,
    PRESET_NAME,
    RIG_NAME,
    TEXT,
    UNTOUCHED_NAME,
    Topic,
    parse,
)
from .reader import McapFile

#: How the images of each topic are read, from a message and the shape (H, W) that the rig states.
_IMAGES: dict[Topic, Callable[[RawImage, tuple[int, int]], AnyArray]] = {
    Topic.PROXIMITY_DEPTH: RawImage.counts,
    Topic.PROXIMITY_COLOR: RawImage.color,
    Topic.TACTILE_DEPTH: RawImage.counts,
    Topic.TACTILE_COLOR: RawImage.color,
    Topic.TRUTH_CONTACT: lambda image, shape: image.channel(shape, ("mono8",), np.dtype(np.uint8)),
    Topic.TRUTH_DEPTH: lambda image, shape: image.channel(shape, ("32FC1",), np.dtype(np.float32)),
}


class McapSource(SeekableSource):
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
        self._file = McapFile(self._path, progress)
        try:
            places = {topic: self._file.places(topic) for topic in (Topic.FRAME, *_IMAGES)}
            self._check_topics(places)
            self._about = self._file.metadata.get(METADATA_NAME, {})
            self._refuse_newer_format()
            self._main = Topic.PROXIMITY_DEPTH if len(places[Topic.PROXIMITY_DEPTH]) else Topic.TACTILE_DEPTH
            times_ns = _log_times(places[self._main])
            exact = bool(np.isin(times_ns, _log_times(places[Topic.FRAME])).all())
            self._places = places
            self._unmatched = 0
            if exact:
                self._partners = {topic: _partners(times_ns, _log_times(table)) for topic, table in places.items()}
            else:
                self._partners = self._pair_by_stamps(places)
            self._gap_s = float(np.median(np.diff(times_ns))) * 1e-9 if len(times_ns) > 1 else 0.0
            super().__init__(name, self._read_rig(), len(self._partners[self._main]))
            self.read(0)
        except BaseException:
            self._file.close()
            raise

    @property
    def frame_rate_hz(self) -> float:
        """The rate in the recording's metadata, or else that of its log times."""
        try:
            named_hz = float(self._about["frame_rate_hz"])
        except (KeyError, ValueError):
            named_hz = 0.0
        if 0.0 < named_hz < math.inf:
            return named_hz
        return 1.0 / self._gap_s if self._gap_s > 0 else super().frame_rate_hz

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
            data = self._file.attachment(PRESET_NAME)
        except SourceError as error:
            raise PresetError(str(error)) from error
        return None if data is None else (data.decode(errors="replace"), f"{PRESET_NAME} in {self._path}")

    def untouched(self) -> SensorFrame | None:
        data = self._file.attachment(UNTOUCHED_NAME)
        return None if data is None else parse_untouched(data, str(self._path))

    @property
    def has_poses(self) -> bool:
        return Topic.OBJECT_POSE in self._file.topics

    def health(self) -> Health:
        lacks = []
        if not self._file.complete:
            lacks.append(f"this recording was cut off; it plays up to its last complete frame, number {self._length}")
        if self._rig.has_proximity and not len(self._places[Topic.PROXIMITY_COLOR]):
            lacks.append("this recording has no proximity colour: its image stays black")
        if self._unmatched:
            lacks.append(f"{self._unmatched} images without one of the other camera are left out")
        return Health(ok=not lacks, message="; ".join(lacks), unmatched=self._unmatched)

    def close(self) -> None:
        self._file.close()

    def read(self, index: int) -> SensorFrame:
        rig, sequence, proximity = self._rig, index, None
        shape = rig.tactile.intrinsics.shape
        depth, time_s = self._required(Topic.TACTILE_DEPTH, index, shape)
        tactile = Shot(depth, self._optional(Topic.TACTILE_COLOR, index, shape), time_s)
        if rig.has_proximity:
            depth, time_s = self._required(Topic.PROXIMITY_DEPTH, index, rig.proximity.intrinsics.shape)
            color = self._optional(Topic.PROXIMITY_COLOR, index, rig.proximity_color_shape)
            proximity = Shot(depth, color, time_s)
        if (place := self._place(Topic.FRAME, index)) is not None:
            sequence, time_s, tactile_time_s = self._frame_record(place)
            tactile = tactile._replace(time_s=tactile_time_s)
            proximity = None if proximity is None else proximity._replace(time_s=time_s)
        return SensorFrame.of_shots(rig, sequence, proximity, tactile, self._truth(index))

    def _check_topics(self, places: dict[Topic, Uint64Array]) -> None:
        topics = self._file.topics
        if not len(places[Topic.TACTILE_DEPTH]):
            known = f"its topics are {', '.join(sorted(topics)[:8])}" if topics else "it has no messages"
            cut = "" if self._file.complete else "it was cut off before its first frame was complete; "
            raise SourceError(
                f"{self._path} holds no frame: {cut}there is no image on {Topic.TACTILE_DEPTH} ({known}); "
                "choose another recording"
            )
        for topic in places:
            expected = TEXT if topic == Topic.FRAME else IMAGE
            if topic in topics and topics[topic] != (expected, "cdr"):
                kind, encoding = topics[topic]
                raise SourceError(
                    f"{self._path}: {topic} has messages of the type {kind} in {encoding}, but {expected} in cdr is "
                    "needed; name the topics of its images with --topics tactile.depth=/topic"
                )

    def _pair_by_stamps(self, places: dict[Topic, Uint64Array]) -> dict[Topic, IndexArray]:
        """Return, for each frame, the index of its message of each topic, or -1."""
        stamps_s = {topic: self._stamps_s(places[topic]) for topic in _IMAGES}
        first, second = stamps_s[self._main], stamps_s[Topic.TACTILE_DEPTH]
        farthest_s = min(period_s(first), period_s(second)) / 2
        chosen, partner = pairs(first, second, farthest_s)
        if not len(chosen):
            raise SourceError(
                f"{self._path}: no proximity image has a tactile one within {farthest_s * 1e3:.1f} ms by the stamps in "
                "their headers; set the clocks of both cameras"
            )
        self._unmatched = len(first) + len(second) - 2 * len(chosen)
        found: dict[Topic, IndexArray] = {}
        stamps_s[Topic.FRAME] = np.array([self._frame_record(place)[1] for place in places[Topic.FRAME]], np.float64)
        for topic, candidates in stamps_s.items():
            found[topic] = nearest_within(first[chosen], candidates, farthest_s)
        return found | {self._main: chosen, Topic.TACTILE_DEPTH: partner}

    def _stamps_s(self, places: Uint64Array) -> Float64Array:
        """Return the stamps in the headers of messages, which begin with them behind four bytes."""
        found = [struct.unpack_from("<II", self._file.message(place), 4) for place in places]
        return np.array([seconds + nanoseconds * 1e-9 for seconds, nanoseconds in found], np.float64)

    def _refuse_newer_format(self) -> None:
        version = self._about.get("format_version", str(FORMAT_VERSION))
        if version != str(FORMAT_VERSION):
            raise SourceError(f"{self._path} has the format version {version}; open it with a newer Tactune")

    def _read_rig(self) -> Rig:
        data = self._file.attachment(RIG_NAME)
        if data is None and len(places := self._file.places(Topic.RIG)):
            data = self._parse(places[0], TEXT).data.encode()
        if data is None:
            told = "write its images to a folder and describe the cameras with tactune preset create-rig"
            raise SourceError(f"{self._path} has no {RIG_NAME} and no {Topic.RIG}: {told}")
        return parse_rig(self._json_object(data, RIG_NAME), f"{RIG_NAME} in {self._path}")

    def _frame_record(self, place: Uint64Array) -> tuple[int, float, float]:
        data = self._json_object(self._parse(place, TEXT).data, Topic.FRAME)
        try:
            return int(data["sequence"]), float(data["proximity_time_s"]), float(data["tactile_time_s"])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise SourceError(
                f"{self._path}: a message of {Topic.FRAME} is damaged; copy the recording again"
            ) from error

    def _truth(self, index: int) -> GroundTruth | None:
        shape = self._rig.proximity.intrinsics.shape
        contact = self._optional(Topic.TRUTH_CONTACT, index, shape)
        return None if contact is None else GroundTruth(contact != 0, self._optional(Topic.TRUTH_DEPTH, index, shape))

    def _place(self, topic: Topic, index: int) -> Uint64Array | None:
        """Return where a frame's message of a topic lies, or None if it has none."""
        partner = self._partners[topic][index]
        return None if partner < 0 else self._places[topic][partner]

    def _required(self, topic: Topic, index: int, shape: tuple[int, int]) -> tuple[AnyArray, float]:
        place = self._place(topic, index)
        if place is None:
            raise SourceError(f"{self._path}: frame {index} has no image on {topic}; copy the recording again")
        return self._image(topic, place, shape)

    def _optional(self, topic: Topic, index: int, shape: tuple[int, int]) -> AnyArray | None:
        place = self._place(topic, index)
        return None if place is None else self._image(topic, place, shape)[0]

    def _image(self, topic: Topic, place: Uint64Array, shape: tuple[int, int]) -> tuple[AnyArray, float]:
        """Return an image and its time stamp in seconds."""
        found = self._parse(place, IMAGE)
        try:
            image = _IMAGES[topic](RawImage.of(found), shape)
        except DamagedFileError as error:
            raise SourceError(f"{self._path}: an image on {topic} cannot be read ({error}); convert it") from error
        return image, found.header.stamp.sec + found.header.stamp.nanosec * 1e-9

    def _parse(self, place: Uint64Array, message_type: str) -> Any:
        return parse(self._file.message(place), message_type, self._path)

    def _json_object(self, data: str | bytes, what: str) -> dict[str, Any]:
        try:
            value = parse_json(data)
        except ValueError:
            value = None
        if not isinstance(value, dict):
            raise SourceError(f"{self._path}: {what} is no JSON object; copy the recording again")
        return value


def is_ours(text: str) -> bool:
    """Whether a file of this name says its rig, as Tactune's recordings and copies of them do."""
    paths = recording_files(text)
    if len(paths) != 1:
        return not paths  # it is told that there is none
    with closing(McapFile(paths[0])) as file:
        return file.attachment(RIG_NAME) is not None or Topic.RIG in file.topics or not file.topics


def _log_times(places: Uint64Array) -> Int64Array:
    return places[:, 0].astype(np.int64)


def _partners(times_ns: Int64Array, candidates_ns: Int64Array) -> IndexArray:
    """Return, for each frame, the index of the message with the same log time; -1 if there is none."""
    if not len(candidates_ns):
        return np.full(len(times_ns), -1)
    partner = nearest(times_ns, candidates_ns)
    return np.where(candidates_ns[partner] == times_ns, partner, -1)
