"""Plays a ROS recording that somebody made with any program: two depth cameras, or one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import cv2
import numpy as np

from ...errors import SourceError, foreign
from ...model.arrays import AnyArray, Float64Array, Uint8Array
from ...model.files import recording_paths
from ...model.frames import DepthCamera, Matrix4, camera_pose
from ..base import CameraRole, Progress, part_of
from ..cameras.camera import Calibration
from ..cameras.pairing import nearest_within, period_s
from ..lens_files import Lens, camera_info_lens, lens_of_file
from ..recorded import RecordedCamera, RecordedSource
from ..ros_image import COLORS, FLOAT_UNIT_M, RawImage, damage_told
from .bags import open_bag
from .messages import POSES, Bag, matrix_of
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
    unread_depth,
)

#: Unit of depth in whole numbers, by ROS's convention for depth images (REP 118).
COUNT_UNIT_M: Final = 0.001
#: Camera infos that are tried until one is filled in.
_TRIED_INFOS: Final = 100
#: Messages of poses of each topic that are read.
_TRIED_POSES: Final = 1000
#: How a person names topics, for the end of a message.
NAMING: Final = "--topics proximity.depth=/topic,tactile.depth=/topic,tactile.info=lens.yaml"
#: Size of the pictures of topics, pixels.
_PICTURE_PX: Final = 160
#: A pose between two frames that changes by more than this, metres and radians, is none of a rig.
_FIXED: Final = 1e-6


class GapError(Exception):
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
            # what is not filled in is nan, and no pose
            if np.isfinite(found).all() and np.ptp(np.array(found), axis=0).max() <= _FIXED:
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


@dataclass(frozen=True, eq=False)
class Inspection:
    """What a person chooses from: topics, pictures (RGB), and a guess or the clause that says why there is none."""

    images: tuple[ImageTopic, ...]
    guess: Topics
    gap: str
    pictures: dict[str, Uint8Array]


def inspect_recording(text: str, progress: Progress | None = None) -> Inspection | None:
    """Return what there is to choose from; None where the topics have been chosen before."""
    paths = recording_paths(text)
    path = paths[0]
    if load_topics(path):
        return None
    with closing(open_bag(paths, progress)) as bag, damage_told(path, "it is damaged"):
        images, frames = survey(bag), Frames(bag)
        guess, gap = guess_topics(images, frames.pose)
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


class Stream(NamedTuple):
    """A topic of images, their lens, and the topic that states it; empty if a file does, or another stream's."""

    topic: ImageTopic
    lens: Lens
    info: str

    def pixels(self, message: Any, *, copy: bool = True) -> AnyArray:
        """Return counts, uint16 (H, W), or RGB, uint8 (H, W, 3); without ``copy`` maybe memory that is read only."""
        image, shape = RawImage.of(message), (self.topic.height, self.topic.width)
        is_depth = self.topic.kind == "depth"
        return self.lens.rectify(image.depth(shape, copy=copy) if is_depth else image.color(shape, copy=copy))


@dataclass(frozen=True, eq=False)
class StatedCamera:
    """One camera as its topics state it; a colour that cannot be used is left out."""

    depth: Stream
    color: Stream | None
    calibration: Calibration


@dataclass(frozen=True, eq=False)
class StatedRig:
    """Cameras by role, the pose between two if it is known, and clauses about what is missing."""

    cameras: dict[CameraRole, StatedCamera]
    pose: Matrix4 | None
    lacks: list[str]


def stated_rig(bag: Bag, images: Sequence[ImageTopic], announced: Mapping[str, str], chosen: Topics) -> StatedRig:
    """Return the cameras on these topics, or on those that names tell; `GapError` if something necessary is missing.

    ``images`` are those of a bag, ``announced`` the types of all topics that there are.
    """
    lacks: list[str] = []
    frames = Frames(bag)
    topics, gap = guess_topics(images, frames.pose)
    if chosen:
        topics, gap = complete_topics(chosen, topics, images, frames.pose)
    if gap:
        raise GapError(gap)
    known = {image.name: image for image in images}
    for slot, name in topics.items():
        if not slot.endswith(".info") and name not in known:
            raise GapError(f"there are no images on {name}, named as {slot}")
    roles: list[CameraRole] = ["proximity", "tactile"] if "proximity.depth" in topics else ["tactile"]
    cameras = {role: _stated_camera(bag, frames, known, topics, role, lacks) for role in roles}
    if len(cameras) == 1:
        if not chosen and (unread := unread_depth(known, announced, topics["tactile.depth"])):
            lacks.append(f"only one camera is shown, since no depth comes on {', '.join(unread)} that can be read")
        return StatedRig(cameras, None, lacks)
    frame, other = (camera.depth.topic.frame for camera in cameras.values())
    pose, first, second = frames.pose(frame, other), foreign(frame, 60), foreign(other, 60)
    if pose is None:
        lacks.append(f"no fixed transform joins the cameras ({first} and {second}): calibrate the alignment")
    elif not pose[:3, 3].any():  # two drivers that were left with the same frame names
        lacks.append(f"both cameras are said to be at one place ({first} and {second}): calibrate the alignment")
    else:
        try:
            return StatedRig(cameras, camera_pose(pose), lacks)
        except ValueError as error:
            lacks.append(f"the pose between {first} and {second} is not used: {error}")
    return StatedRig(cameras, None, lacks)


def _stated_camera(
    bag: Bag, frames: Frames, images: Mapping[str, ImageTopic], topics: Topics, role: CameraRole, lacks: list[str]
) -> StatedCamera:
    depth = images[topics[f"{role}.depth"]]
    if depth.kind != "depth":
        raise GapError(f"{depth} has no depth, but is named as {role}.depth")
    stated = topics.get(f"{role}.info", depth.info)
    is_file = stated not in bag.types and Path(stated).is_file()
    lens = lens_of_file(Path(stated), role, (depth.width, depth.height)) if is_file else _lens(bag, depth, stated)
    stream = Stream(depth, lens, "" if is_file else stated)
    calibration = Calibration(
        DepthCamera(
            model=foreign(depth.camera.replace("/", " ") or role, 80),
            intrinsics=lens.intrinsics,
            depth_unit_m=FLOAT_UNIT_M if depth.encoding == "32FC1" else COUNT_UNIT_M,
        )
    )
    if f"{role}.color" in topics:
        color = images[topics[f"{role}.color"]]
        try:
            color_lens, pose = _color(bag, frames, color, depth, lens)
            calibration = Calibration(calibration.depth, color_lens.intrinsics, camera_pose(pose))
            return StatedCamera(stream, Stream(color, color_lens, color.info), calibration)
        except (GapError, ValueError) as gap:
            lacks.append(f"the {role} colour is left out: {gap}")
    return StatedCamera(stream, None, calibration)


def _color(bag: Bag, frames: Frames, color: ImageTopic, depth: ImageTopic, lens: Lens) -> tuple[Lens, Float64Array]:
    """Return the lens of a camera's colour and the pose of its depth in it."""
    if color.kind != "color" or color.encoding not in COLORS:
        raise GapError(f"{color.name} has no colour that is known: its encoding is {foreign(color.encoding, 40)!r}")
    pose = frames.pose(color.frame, depth.frame)
    if pose is None:
        told = f"no fixed transform joins its frame {color.frame!r} to the depth's, {depth.frame!r}"
        raise GapError(f"{told}; give /tf_static, or colour that is aligned to the depth")
    if not color.info and color.frame == depth.frame and (color.width, color.height) == (depth.width, depth.height):
        return lens, pose  # aligned to the depth
    return _lens(bag, color, color.info), pose


def _lens(bag: Bag, image: ImageTopic, topic: str) -> Lens:
    """Return the lens of the first message that is filled in."""
    for index in range(min(bag.count(topic), _TRIED_INFOS)):
        info, size = bag.message(topic, index), (image.width, image.height)
        try:
            lens = camera_info_lens(info, size, is_rectified=image.is_rectified)
        except SourceError as error:
            raise GapError(f"{image.name}: {error}") from error
        if lens is not None:
            return lens
    if bag.count(topic):
        raise GapError(f"all numbers of {topic} are 0")
    lack = f"neither a topic nor a file {foreign(topic)}" if topic else "no camera_info"
    raise GapError(f"the lens of {image.name} is unknown: there is {lack}")


class RosSource(RecordedSource):
    """A ROS bag of any program; ``rest`` is its path, and behind a question mark topics, which are kept beside it."""

    def __init__(self, scheme: str, rest: str, progress: Progress | None = None) -> None:
        text, chosen = split_name(rest)
        paths = recording_paths(text)
        self._path, name = paths[0], f"{scheme}:{text}"
        with ExitStack() as resources:
            self._bag = open_bag(paths, progress)
            resources.callback(self._bag.close)
            cut = f"{self._path.name} was cut off: it is shown up to its last whole part"
            self._lacks = [] if self._bag.complete else [cut]
            with damage_told(self._path, "it is damaged"):
                rig = self._stated_rig(chosen or load_topics(self._path))
                self._lacks += rig.lacks
                cameras = [
                    self._camera(role, camera, part_of(progress, number, len(rig.cameras)))
                    for number, (role, camera) in enumerate(rig.cameras.items())
                ]
            super().__init__(name, cameras, resources, self._lacks, rig.pose)
            self.read(0)
            self._resources = resources.pop_all()
        if chosen:
            store_topics(self._path, chosen)

    def _stated_rig(self, chosen: Topics) -> StatedRig:
        images = survey(self._bag)
        if not self._bag.types:
            cut = "" if self._bag.complete else ": it was cut off"
            raise SourceError(f"{self._path} has no messages{cut}; choose another")
        try:
            return stated_rig(self._bag, images, self._bag.types, chosen)
        except GapError as gap:
            raise SourceError(
                f"{self._path}: {'; '.join([*self._lacks, str(gap)])}; name topics, or a file of a lens, with "
                f"{NAMING}; {list_topics(images, self._bag.types)}"
            ) from gap

    def _camera(self, role: CameraRole, stated: StatedCamera, progress: Progress) -> RecordedCamera:
        times_s = self._stamps_s(stated.depth.topic.name, part_of(progress, 0, 2))
        color, partners = None, np.empty(0, np.int64)
        if stated.color is not None:
            color_s = self._stamps_s(stated.color.topic.name, part_of(progress, 1, 2))
            farthest_s = period_s(color_s) / 2
            partners = nearest_within(times_s, color_s, farthest_s)
            if missing := int((partners < 0).sum()):
                self._lacks.append(f"{missing} images have no {role} colour within {farthest_s * 1e3:.0f} ms")
            color = partial(self._read, stated.color)
        depth = partial(self._read, stated.depth)
        return RecordedCamera(self._path, stated.calibration, 1 / period_s(times_s), times_s, depth, color, partners)

    def _stamps_s(self, topic: str, progress: Progress) -> Float64Array:
        stamps_s = self._bag.stamps_s(topic, progress)
        if stamps_s.any():
            return stamps_s
        self._lacks.append(f"the images on {topic} have no time stamps in their headers: the recorder's are used")
        return np.asarray(self._bag.times_ns(topic) * 1e-9, np.float64)

    def _read(self, stream: Stream, index: int) -> AnyArray:
        return stream.pixels(self._bag.message(stream.topic.name, index))
