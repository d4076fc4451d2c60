"""Plays a ROS recording that somebody made with any program: two depth cameras, or one."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from ...errors import SourceError, foreign
from ...model.arrays import AnyArray, Float64Array, IndexArray, Int64Array, Uint8Array, Uint16Array
from ...model.files import user_path
from ...model.frames import DepthCamera, Rig, SensorFrame, camera_pose
from ..base import Health, Progress, SeekableSource
from ..cameras.camera import Calibration
from ..lens import Lens, camera_info_lens
from ..mcap.messages import matrix_of
from ..ros_image import FLOAT_UNIT_M, RawImage, damage_told, nearest_within, pairs, period_s
from .bags import POSES, Bag, open_bag
from .topics import (
    ImageTopic,
    Topics,
    complete_topics,
    guess_topics,
    list_topics,
    load_topics,
    split_name,
    store_topics,
    survey,
)

#: Unit of depth in whole numbers, by ROS's convention for depth images (REP 118).
COUNT_UNIT_M: Final = 0.001
#: Camera infos that are tried until one is filled in.
_TRIED_INFOS: Final = 100
#: Messages of poses of each topic that are read.
_TRIED_POSES: Final = 1000
#: Size of the pictures of topics, pixels.
_PICTURE_PX: Final = 160
#: A pose between two frames that changes by more than this, metres and radians, is none of a rig.
_FIXED: Final = 1e-6


class _GapError(Exception):
    """Something without which an image cannot be used is missing; the message is a clause."""


class Frames:
    """The fixed poses between the coordinate frames of a recording, joined along chains."""

    def __init__(self, bag: Bag) -> None:
        self._edges: dict[str, dict[str, Float64Array]] = {}
        poses: dict[tuple[str, str], list[Float64Array]] = {}
        for topic, kind in bag.types.items():
            if kind not in POSES:
                continue
            count = bag.count(topic)  # of many, some from all over the recording: what moves may rest at first
            for index in np.unique(np.linspace(0, count - 1, min(count, _TRIED_POSES)).astype(int)).tolist():
                for each in bag.message(topic, index).transforms:
                    names = each.header.frame_id.lstrip("/"), each.child_frame_id.lstrip("/")
                    poses.setdefault(names, []).append(matrix_of(each.transform))
        for (parent, child), found in poses.items():
            if np.ptp(np.array(found), axis=0).max() <= _FIXED:
                self._edges.setdefault(parent, {})[child] = found[0]
                self._edges.setdefault(child, {})[parent] = np.asarray(np.linalg.inv(found[0]), np.float64)

    def pose(self, to: str, of: str) -> Float64Array | None:
        """Return ``T_to_of`` (4, 4), which takes coordinates in ``of`` to ``to``; None if no chain joins them."""
        to, of = to.lstrip("/"), of.lstrip("/")
        if not to or not of:
            return None
        known = {to: np.eye(4)}
        waiting = [to]
        while waiting:
            name = waiting.pop(0)
            if name == of:
                return known[name]
            for other, pose in self._edges.get(name, {}).items():
                if other not in known:
                    known[other] = known[name] @ pose
                    waiting.append(other)
        return None

    def joined(self, first: str, second: str) -> bool:
        """Whether the pose between two frames is known."""
        return self.pose(first, second) is not None


@dataclass(frozen=True, eq=False)
class _Stream:
    topic: ImageTopic
    lens: Lens
    stamps_s: Float64Array

    def read(self, bag: Bag, index: int) -> AnyArray:
        """Return counts, uint16 (H, W), or RGB, uint8 (H, W, 3)."""
        image = RawImage.of(bag.message(self.topic.name, index))
        shape = self.topic.height, self.topic.width
        return self.lens.rectify(image.depth(shape) if self.topic.kind == "depth" else image.color(shape))


@dataclass(frozen=True, eq=False)
class _Camera:
    """The depth of one camera and, where it can be used, its colour with its partner of each depth image or -1."""

    calibration: Calibration
    depth: _Stream
    color: _Stream | None
    partners: IndexArray

    def images(self, bag: Bag, index: int) -> tuple[Uint16Array, Uint8Array | None]:
        depth = self.depth.read(bag, index)
        if self.color is None or self.partners[index] < 0:
            return depth, None
        return depth, self.color.read(bag, int(self.partners[index]))


@dataclass(frozen=True, eq=False)
class Inspection:
    """What a person sees before the topics of a recording are chosen.

    ``guess`` is empty and ``gap`` a clause where the names do not tell the topics; ``pictures`` has a small image of
    each topic whose middle image can be shown, RGB uint8 (H, W, 3).
    """

    images: tuple[ImageTopic, ...]
    guess: Topics
    gap: str
    pictures: dict[str, Uint8Array]


def inspect_recording(path: Path, progress: Progress | None = None) -> Inspection | None:
    """Return what there is to choose from; None where the topics have been chosen before."""
    if load_topics(path):
        return None
    with closing(open_bag(path, progress)) as bag, damage_told(path, "it is damaged"):
        images, frames = survey(bag), Frames(bag)
        guess, gap = guess_topics(images, lambda a, b: frames.pose(a, b) is not None)
        pictures = {}
        for image in images:
            with suppress(Exception):  # one that is damaged or of an unknown encoding is listed without a picture
                pictures[image.name] = _picture(bag, image)
    return Inspection(images, guess, gap, pictures)


def _picture(bag: Bag, image: ImageTopic) -> Uint8Array:
    """Return the middle image of a topic, small; of depth, near is bright."""
    raw, shape = RawImage.of(bag.message(image.name, image.count // 2)), (image.height, image.width)
    if image.kind == "color":
        pixels = raw.color(shape)
    else:
        depth = raw.depth(shape).astype(np.float32)
        seen = depth[depth > 0]
        near, far = np.percentile(seen, (2, 98)) if len(seen) else (0.0, 1.0)
        shade = np.where(depth > 0, np.clip((far - depth) / max(far - near, 1.0), 0, 1) * 215 + 40, 0)
        pixels = np.dstack([shade.astype(np.uint8)] * 3)
    scale = _PICTURE_PX / max(shape)
    return np.asarray(cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


class RosSource(SeekableSource):
    """A ROS bag of any program, with frames of depth images whose header stamps are half a period apart at most."""

    def __init__(self, scheme: str, rest: str, progress: Progress | None = None) -> None:
        text, chosen = split_name(rest)
        self._path = user_path(text)
        name = f"{scheme}:{text}"
        if not self._path.exists():
            raise SourceError(f"{name}: there is no file {self._path}; check the path")
        self._bag = open_bag(self._path, progress)
        self._notes: list[str] = []
        try:
            with damage_told(self._path, "it is damaged"):
                rig = self._set_up(chosen or load_topics(self._path), progress)
            super().__init__(name, rig, len(self._first))
            self.read(0)
        except BaseException:
            self._bag.close()
            raise
        if chosen:
            store_topics(self._path, chosen)

    def _set_up(self, chosen: Topics, progress: Progress | None) -> Rig:
        images = survey(self._bag)
        frames = Frames(self._bag)
        topics, gap = guess_topics(images, frames.joined)
        if chosen:
            topics, gap = complete_topics(chosen, topics, images, frames.joined)
        if gap:
            raise SourceError(
                f"{self._path}: {gap}; name them with --topics proximity.depth=/topic,tactile.depth=/topic; "
                f"{list_topics(images, self._bag.types)}"
            )
        known = {image.name: image for image in images}
        cameras = [
            self._camera(role, topics, known, frames, progress)
            for role in ("proximity", "tactile")
            if f"{role}.depth" in topics
        ]
        self._main = cameras[0]
        self._tactile = cameras[1] if len(cameras) == 2 else None
        self._pair()
        proximity = self._main.calibration
        if self._tactile is None:
            return Rig.of_one_camera(proximity.depth)
        pose = frames.pose(self._main.depth.topic.frame, self._tactile.depth.topic.frame)
        if pose is not None and not pose[:3, 3].any():  # two drivers that were left with the same frame names
            self._notes.append(
                f"both cameras are said to be at the same place (frames {self._main.depth.topic.frame} and "
                f"{self._tactile.depth.topic.frame}), so the pose between them is unknown: calibrate the alignment"
            )
            pose = None
        elif pose is None:
            self._notes.append(
                "the pose between the cameras is not in this recording "
                f"(no chain of fixed transforms from {self._main.depth.topic.frame or 'an unnamed frame'} to "
                f"{self._tactile.depth.topic.frame or 'an unnamed frame'}): calibrate the alignment"
            )
        return Rig(
            proximity=proximity.depth,
            tactile=self._tactile.calibration.depth,
            proximity_color=proximity.color_camera,
            T_proximity_tactile=None if pose is None else camera_pose(pose),
        )

    def _camera(
        self, role: str, topics: Topics, known: dict[str, ImageTopic], frames: Frames, progress: Progress | None
    ) -> _Camera:
        image = self._image_topic(f"{role}.depth", topics[f"{role}.depth"], known)
        if image.kind != "depth":
            raise SourceError(f"{self._path}: {image} has no depth; choose another as {role}.depth")
        lens_topic = topics.get(f"{role}.info", image.info)
        if lens_topic not in self._bag.types:
            raise SourceError(
                f"{self._path}: the lens of {image.name} is missing (a topic camera_info); name it with "
                f"--topics {role}.info=/topic"
            )
        depth = self._stream(image, lens_topic, progress)
        unit_m = FLOAT_UNIT_M if depth.topic.encoding == "32FC1" else COUNT_UNIT_M
        model = foreign(depth.topic.camera.replace("/", " ") or role, 80)
        info = DepthCamera(model=model, intrinsics=depth.lens.intrinsics, depth_unit_m=unit_m)
        if f"{role}.color" not in topics:
            return _Camera(Calibration(info), depth, None, np.empty(0, np.int64))
        try:
            color, pose = self._color(role, topics[f"{role}.color"], depth, known, frames, progress)
        except _GapError as gap:
            self._notes.append(f"the {role} colour is left out: {gap}")
            return _Camera(Calibration(info), depth, None, np.empty(0, np.int64))
        farthest_s = period_s(color.stamps_s) / 2
        partners = nearest_within(depth.stamps_s, color.stamps_s, farthest_s)
        if missing := int((partners < 0).sum()):
            self._notes.append(f"{missing} images have no {role} colour within {farthest_s * 1e3:.0f} ms")
        return _Camera(Calibration(info, color.lens.intrinsics, camera_pose(pose)), depth, color, partners)

    def _color(
        self,
        role: str,
        name: str,
        depth: _Stream,
        known: dict[str, ImageTopic],
        frames: Frames,
        progress: Progress | None,
    ) -> tuple[_Stream, Float64Array]:
        """Return the colour of a camera and the pose of its depth in it."""
        image = self._image_topic(f"{role}.color", name, known)
        ours, theirs = depth.topic.frame, image.frame
        pose = frames.pose(theirs, ours)
        if pose is None:
            raise _GapError(f"no fixed transform joins its frame {theirs!r} to the frame of the depth, {ours!r}")
        if image.info:
            return self._stream(image, image.info, progress), pose
        if ours == theirs and (image.width, image.height) == (depth.topic.width, depth.topic.height):
            return _Stream(image, depth.lens, self._stamps_s(name, progress)), pose  # aligned to the depth
        raise _GapError(f"{name} has no camera_info, so its lens is unknown")

    def _image_topic(self, slot: str, name: str, known: dict[str, ImageTopic]) -> ImageTopic:
        if name not in known:
            there = list_topics(list(known.values()), self._bag.types)
            raise SourceError(f"{self._path} has no images on {name}, named as {slot}; {there}")
        return known[name]

    def _stream(self, image: ImageTopic, info: str, progress: Progress | None) -> _Stream:
        try:
            lens = self._lens(info, (image.width, image.height))
        except SourceError as error:
            raise SourceError(f"{self._path}: {image.name}: {error}") from error
        if lens is None:
            raise SourceError(f"{self._path}: {info} states no lens: all its numbers are 0; name another topic")
        return _Stream(image, lens, self._stamps_s(image.name, progress))

    def _lens(self, topic: str, size: tuple[int, int]) -> Lens | None:
        """Return the lens of the first message that is filled in."""
        for index in range(min(self._bag.count(topic), _TRIED_INFOS)):
            if (lens := camera_info_lens(self._bag.message(topic, index), size)) is not None:
                return lens
        return None

    def _stamps_s(self, topic: str, progress: Progress | None) -> Float64Array:
        count = self._bag.count(topic)
        stamps_ns: Int64Array = np.empty(count, np.int64)
        for index in range(count):
            if progress is not None and index % 100 == 0:
                progress(index / count, f"reading the time stamps of {topic}")
            stamps_ns[index] = self._bag.stamp_ns(topic, index)
        if count and not stamps_ns.any():
            raise SourceError(f"{self._path}: the images on {topic} have no time stamps in their headers")
        return np.asarray(stamps_ns * 1e-9, np.float64)

    def _pair(self) -> None:
        first = self._main.depth.stamps_s
        self._unmatched = 0
        if self._tactile is None:
            self._first = self._second = np.argsort(first, kind="stable")
            return
        second = self._tactile.depth.stamps_s
        farthest_s = min(period_s(first), period_s(second)) / 2
        self._first, self._second = pairs(first, second, farthest_s)
        self._unmatched = len(first) + len(second) - 2 * len(self._first)
        if not len(self._first):
            raise SourceError(
                f"{self._path}: no image on {self._main.depth.topic.name} has one on "
                f"{self._tactile.depth.topic.name} within {farthest_s * 1e3:.1f} ms by the stamps in their headers; "
                "set the clocks of both cameras, or choose other topics"
            )

    @property
    def frame_rate_hz(self) -> float:
        return 1.0 / period_s(self._main.depth.stamps_s)

    def health(self) -> Health:
        lacks: Sequence[str] = list(self._notes)
        if self._tactile is not None and self._main.color is None:
            lacks = [*lacks, "this recording has no proximity colour: its image stays black"]
        if not self._bag.complete:
            lacks = [*lacks, f"{self._path.name} was cut off: it is shown up to its last whole part"]
        if self._unmatched:
            lacks = [*lacks, f"{self._unmatched} images without one of the other camera are left out"]
        return Health(ok=not lacks, message="; ".join(lacks), unmatched=self._unmatched)

    def close(self) -> None:
        self._bag.close()

    def read(self, index: int) -> SensorFrame:
        first, second = int(self._first[index]), int(self._second[index])
        with damage_told(self._path, f"frame {index} cannot be read"):
            depth, color = self._main.images(self._bag, first)
            if self._tactile is None:
                aligned = None if color is None else self._main.calibration.color_on_depth(color, depth)
                time_s = float(self._main.depth.stamps_s[first])
                return SensorFrame.of_one_camera(index, depth, aligned, time_s)
            tactile_depth, tactile_color = self._tactile.images(self._bag, second)
            if tactile_color is not None:
                tactile_color = self._tactile.calibration.color_on_depth(tactile_color, tactile_depth)
        if color is None:
            color = np.zeros((*self._rig.proximity_color_shape, 3), np.uint8)
        return SensorFrame(
            sequence=index,
            proximity_depth=depth,
            tactile_depth=tactile_depth,
            proximity_color=color,
            tactile_color=tactile_color,
            proximity_time_s=float(self._main.depth.stamps_s[first]),
            tactile_time_s=float(self._tactile.depth.stamps_s[second]),
        )
