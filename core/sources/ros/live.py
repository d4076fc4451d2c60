"""Live ROS 2 topics as cameras: all that have a ROS 2 driver, without a ROS installation.

A camera is what publishes a topic of depth images. Threads, pairing and reopening are those of all live cameras.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import parse_qsl

import numpy as np

from ...errors import SourceError, as_sentence, foreign
from ...model.arrays import Float64Array, Int64Array, Uint8Array
from ...model.frames import DepthCamera, Matrix4, camera_pose
from ...preset import CamerasSection
from ..base import CameraRole, FrameSource, Health, Progress
from ..cameras.camera import Calibration, Camera, CameraDriver, DeviceInfo, Images
from ..cameras.pairing import period_s
from ..cameras.source import CameraSource
from ..capture.source import ProcessSource
from ..lens import Lens, camera_info_lens, lens_of_file
from ..ros_image import FLOAT_UNIT_M, RawImage
from .dds import Listener, Reader, Waiter, check_network, keep_freed_memory
from .messages import CAMERA_INFO, IMAGE, TRANSFORMS, TYPES, Bag, stamp_ns
from .source import COUNT_UNIT_M, Frames
from .topics import COMPRESSED, ImageTopic, Topics, guess_topics, list_topics, split_name, survey, unread_depth

#: Longest search, seconds, and in how many looks nothing new may come before it ends: a busy computer looks rarely.
_SEARCH_S: Final = 6.0
_QUIET_LOOKS: Final = 20
_POLL_S: Final = 0.05
#: Types of messages; the first message of a topic tells size, encoding and lens.
_KINDS: Final = (IMAGE, COMPRESSED, CAMERA_INFO)
#: How long `cameras_here` listens, seconds: images come at least every 0.2 s.
_LOOK_S: Final = 2.0


@dataclass(frozen=True)
class Found:
    """The topic of each slot, the streams of images and the message types by topic, and the poses between frames.

    ``silent`` names the depth of another camera, of which no image has come.
    """

    topics: Topics
    images: Mapping[str, ImageTopic]
    types: Mapping[str, str]
    frames: Frames
    silent: Sequence[str] = ()

    def lens_topic(self, slot: str) -> str:
        """Return the topic of the lens of ``proximity.depth``, say; empty if it is unknown."""
        role, _, what = slot.partition(".")
        named = self.topics.get(f"{role}.info", "") if what == "depth" else ""
        return named or self.images[self.topics[slot]].info

    def gap(self) -> str:
        """Return a clause that says which image or lens is missing; empty if none is."""
        if "tactile.depth" not in self.topics:
            return "no topic is named as tactile.depth"
        for slot, topic in self.topics.items():
            if slot.endswith(".info"):
                continue
            if topic not in self.images:
                return f"no image has come on {topic}, which is to be {slot}"
            if not self.lens_topic(slot):
                return f"the lens of {topic} is missing (no camera_info; {slot.partition('.')[0]}.info=FILE names one)"
        return ""


def find_topics(name: str, listener: Listener, chosen: Topics, progress: Progress) -> Found:
    """Listen until the topics of the cameras are known; `SourceError` names the source and says what was heard."""
    heard = _Heard(listener)
    began_s, quiet = time.monotonic(), 0
    found, gap = Found({}, {}, {}, Frames(heard)), "no topic has depth images"
    while (spent_s := time.monotonic() - began_s) < _SEARCH_S and (gap or found.silent or quiet < _QUIET_LOOKS):
        progress(0.2 * spent_s / _SEARCH_S, "looking for ROS 2 topics")
        quiet += 1
        if heard.listen():
            quiet = 0
            images, frames = survey(heard), Frames(heard)
            topics, gap = (chosen, "") if chosen else guess_topics(images, frames.joined)
            if "tactile.depth" not in topics:  # a camera alone is a tactile one
                topics = {slot.replace("proximity", "tactile"): topic for slot, topic in topics.items()}
            found = Found(topics, {image.name: image for image in images}, heard.types, frames)
            gap = gap or found.gap()
            if not (chosen or gap or "proximity.depth" in topics):
                found = replace(found, silent=unread_depth(found.images, heard.announced, topics["tactile.depth"]))
        time.sleep(_POLL_S)
    if not gap:
        return found
    if not heard.announced:
        raise SourceError(
            f"{name}: nobody has published in ROS 2 domain {listener.domain} for {_SEARCH_S:.0f} s; start the camera's "
            "ROS 2 driver, name its domain as in ros2:?domain=3, and check that the network lets UDP through"
        )
    silent = [foreign(topic, 60) for topic in sorted(set(heard.announced) - set(heard.types))]
    raise SourceError(
        f"{name}: {gap} in ROS 2 domain {listener.domain}; name the topics with --topics "
        f"proximity.depth=/topic,tactile.depth=/topic; {list_topics(list(found.images.values()), heard.types)}"
        + (f"; without messages so far: {', '.join(silent[:8])}" if silent else "")
    )


class _Heard(Bag):
    """The first message of each topic of cameras, and all fixed transforms, as a recording would hold them."""

    def __init__(self, listener: Listener) -> None:
        super().__init__()
        self.announced: dict[str, str] = {}
        self._listener = listener
        self._readers: dict[str, Reader] = {}
        self._messages: dict[str, list[bytes]] = {}

    def listen(self) -> bool:
        """Take what has come since; return whether there is anything new."""
        before = self.announced, sum(map(len, self._messages.values()))
        self.announced = self._listener.topics()
        for topic, kind in self.announced.items():
            is_fixed = kind == TRANSFORMS and topic.endswith("tf_static")
            if topic not in self._readers and topic not in self.types and (is_fixed or kind in _KINDS):
                self._readers[topic] = self._listener.read(topic, kind)
        for topic, reader in list(self._readers.items()):
            if messages := reader.take():
                self.types[topic] = self.announced.get(topic, "")
                self._messages.setdefault(topic, []).extend(messages)
                if self.types[topic] in _KINDS:
                    del self._readers[topic]
        return (self.announced, sum(map(len, self._messages.values()))) != before

    def count(self, topic: str) -> int:
        return len(self._messages.get(topic, ()))

    def raw(self, topic: str, index: int) -> memoryview:
        return memoryview(self._messages[topic][index])

    def times_ns(self, topic: str) -> Int64Array:
        return np.zeros(self.count(topic), np.int64)

    def close(self) -> None:
        self._readers.clear()


_ANY_NETWORK: Final = "0.0.0.0"  # noqa: S104  # ROS 2 listens to all
#: Longest wait for a lens and the first images of a camera, seconds; below that after which a driver counts as hung.
_OPENING_S: Final = 2.5
#: Depth images whose stamps tell the rate.
_TIMED: Final = 8
#: How long a depth image waits for its colour, seconds.
_PATIENCE_S: Final = 0.15


def open_in_process(rest: str, progress: Progress | None, cameras: CamerasSection | None) -> FrameSource:
    """Open topics by the text after the scheme, such as ``?domain=3``."""
    _read_name(rest)
    return ProcessSource(partial(open_topics, rest, cameras or CamerasSection()), progress)


def cameras_here() -> list[ImageTopic]:
    """Return the depth topics that are published in the domain of ``ros2:``; `SourceError` if it cannot be heard."""
    domain, host, _ = _read_name("")
    with closing(_listen("ros2", domain, host)) as listener:
        heard, end_s = _Heard(listener), time.monotonic() + _LOOK_S
        while time.monotonic() < end_s:
            heard.listen()
            time.sleep(_POLL_S)
        return [image for image in survey(heard) if image.kind == "depth"]


def open_topics(rest: str, cameras: CamerasSection, progress: Progress) -> FrameSource:
    """Find the topics of the cameras and open them; picklable."""
    domain, host, chosen = _read_name(rest)
    name = f"ros2:{rest}"
    keep_freed_memory()
    listener = _listen(name, domain, host)
    try:
        return Ros2Source(name, listener, find_topics(name, listener, chosen, progress), cameras, progress)
    except BaseException:
        listener.close()
        raise


def _listen(name: str, domain: int, host: str) -> Listener:
    try:
        return Listener(domain, host)
    except ValueError as error:
        raise SourceError(f"{name}: {error}") from error


def _read_name(rest: str) -> tuple[int, str, Topics]:
    """Return domain, address of the network interface, and the topics that a person named."""
    query, topics = split_name(rest)
    values = {"domain": os.environ.get("ROS_DOMAIN_ID") or "0", "host": _ANY_NETWORK}
    try:
        given = dict(parse_qsl(query.removeprefix("?"), keep_blank_values=True, strict_parsing=bool(query)))
        if given.keys() - values or (query and not query.startswith("?")):
            raise ValueError("the only options are domain and host, as in ros2:?domain=3&host=127.0.0.1")
        values |= given
        if not values["domain"].isdecimal():
            raise ValueError(f"the domain is {foreign(values['domain'], 40)!r}, no whole number")
        check_network(int(values["domain"]), values["host"])
    except ValueError as error:
        raise SourceError(f"ros2:{foreign(rest)}: {error}") from error
    return int(values["domain"]), values["host"], topics


class Ros2Source(CameraSource):
    """The cameras whose topics were found, paired by the stamps in their headers."""

    def __init__(
        self, name: str, listener: Listener, found: Found, cameras: CamerasSection, progress: Progress | None = None
    ) -> None:
        self._listener = listener
        self._driver = Ros2Driver(listener, found)
        infos = {info.role: info for info in self._driver.devices()}
        chosen: dict[str, Any] = {
            str(role): getattr(cameras, str(role)).model_copy(update={"serial": info.serial, "options": {}})
            for role, info in infos.items()
        }
        roles = tuple(info.role for info in self._driver.devices() if info.role is not None)
        first, second = (found.images[found.topics[f"{role}.depth"]].frame for role in (roles[0], roles[-1]))
        pose = found.frames.pose(first, second)
        if pose is None:
            self._driver.notes["pose"] = (
                f"no chain of fixed transforms joins the frames {foreign(first, 60)!r} and {foreign(second, 60)!r} "
                "of the cameras: calibrate the alignment"
            )
        if found.silent:
            silent = ", ".join(found.silent)
            self._driver.notes["camera"] = f"only one camera is shown, since no depth comes on {silent}"
        super().__init__([self._driver], cameras.model_copy(update=chosen), progress, name=name, roles=roles)
        if pose is not None:
            self._rig = self._rig.model_copy(update={"T_proximity_tactile": camera_pose(pose)})

    def health(self) -> Health:
        health = super().health()
        notes = map(as_sentence, self._driver.notes.values())
        return replace(health, message=" ".join(filter(None, [health.message, *notes])))

    def close(self) -> None:
        super().close()
        self._listener.close()


class _TopicInfo(DeviceInfo):
    @property
    def title(self) -> str:
        return f"camera {self.serial}"


class Ros2Driver(CameraDriver):
    """The cameras of a domain, with topics of depth as serial numbers; ``notes`` are clauses about what topics lack."""

    title = "ROS 2"

    def __init__(self, listener: Listener, found: Found) -> None:
        self.notes: dict[str, str] = {}
        self._listener, self._found = listener, found

    def devices(self) -> list[DeviceInfo]:
        return [self._info(role) for role in ("proximity", "tactile") if f"{role}.depth" in self._found.topics]

    def open(self, serial: str, role: CameraRole) -> Camera:
        depth = _Stream(self._listener, self._found, f"{role}.depth")
        color = _Stream(self._listener, self._found, f"{role}.color") if f"{role}.color" in self._found.topics else None
        pose = np.eye(4)
        if color is not None and color.frame != depth.frame:
            joined = self._found.frames.pose(color.frame, depth.frame)
            if joined is None:
                self.notes[role] = (
                    f"the {role} colour is left out: no fixed transform joins its frame {foreign(color.frame, 60)!r} "
                    f"to the depth's {foreign(depth.frame, 60)!r}"
                )
                color = None
            else:
                pose = joined
        return Ros2Camera(self._listener, self._info(role), role, depth, color, camera_pose(pose))

    def _info(self, role: CameraRole) -> _TopicInfo:
        image = self._found.images[self._found.topics[f"{role}.depth"]]
        model = foreign(image.camera.replace("/", " ") or role, 80)
        return _TopicInfo(model, image.name, role)


class _Message(NamedTuple):
    """An image that is still in CDR; ``arrival_s`` is by `time.monotonic`."""

    stamp_s: float
    arrival_s: float
    data: bytes

    def image(self, kind: str) -> RawImage:
        return RawImage.of(TYPES.deserialize_cdr(memoryview(self.data), kind))  # bytes would be copied


class _Stream:
    """A topic of images with that of its lens."""

    def __init__(self, listener: Listener, found: Found, slot: str) -> None:
        image = found.images[found.topics[slot]]
        self.topic, self.frame, self.is_metres = image.name, image.frame, image.encoding == "32FC1"
        self.shape, self.is_rectified = (image.height, image.width), image.is_rectified
        self.kind = found.types[image.name]
        self.reader = listener.read(image.name, self.kind)
        self.waiting: deque[_Message] = deque()
        stated = found.lens_topic(slot)
        self._infos: Reader | None = None
        self._lens: Lens | None = None
        if Path(stated).is_file():
            self._lens = lens_of_file(Path(stated), slot.partition(".")[0], self.shape[::-1])
        else:
            self._infos = listener.read(stated, CAMERA_INFO)

    def take(self) -> None:
        """Add the images that have come to those that wait."""
        for data in self.reader.take():
            self.waiting.append(_Message(1e-9 * stamp_ns(data), time.monotonic(), data))

    def find_lens(self) -> Lens | None:
        """Return the lens; None until a message that is filled in has come."""
        if self._infos is not None:
            for data in self._infos.take():
                info = TYPES.deserialize_cdr(data, CAMERA_INFO)
                try:
                    self._lens = camera_info_lens(info, self.shape[::-1], is_rectified=self.is_rectified)
                except SourceError as error:
                    raise SourceError(
                        f"{self.topic}: {error}; leave it out, or name a file of the depth's lens (--topics)"
                    ) from error
                if self._lens is not None:
                    self._infos = None
                    break
        return self._lens


class Ros2Camera(Camera):
    """Depth and colour images of one camera, paired by their stamps."""

    def __init__(
        self,
        listener: Listener,
        info: DeviceInfo,
        role: CameraRole,
        depth: _Stream,
        color: _Stream | None,
        T_color_depth: Matrix4,
    ) -> None:
        self._depth, self._color = depth, color
        self._waiter = Waiter(listener, [stream.reader for stream in (depth, color) if stream is not None])
        self._number, self._last_s = 0, 0.0
        lens, color_lens, stamps_s = self._wait_for_calibration(info)
        calibration = Calibration(
            DepthCamera(
                model=info.model,
                intrinsics=lens.intrinsics,
                depth_unit_m=FLOAT_UNIT_M if depth.is_metres else COUNT_UNIT_M,
            ),
            None if color_lens is None else color_lens.intrinsics,
            T_color_depth,
        )
        self._lens, self._color_lens = lens, color_lens
        super().__init__(info, role, calibration, round(1 / period_s(stamps_s), 1))

    def _wait_for_calibration(self, info: DeviceInfo) -> tuple[Lens, Lens | None, Float64Array]:
        """Return the lenses, and the stamps of the first depth images."""
        depth, color = self._depth, self._color
        end_s = time.monotonic() + _OPENING_S
        while True:
            self._waiter.wait(0.05)
            depth.take()
            lens, color_lens = depth.find_lens(), None if color is None else color.find_lens()
            if lens is not None and len(depth.waiting) >= _TIMED and (color is None or color_lens is not None):
                break
            if time.monotonic() > end_s:
                if not depth.reader.entity.get_matched_publications():
                    raise SourceError(f"nobody publishes {depth.topic}; start the camera's ROS 2 driver")
                without = [s.topic for s in (depth, color) if s is not None and s.find_lens() is None]
                lacks = f"no lens of {without[0]} has come" if without else f"{len(depth.waiting)} images have come"
                raise SourceError(f"the {info.title} has not started within {_OPENING_S:g} s: {lacks}")
        stamps_s = np.array([message.stamp_s for message in depth.waiting])
        if not stamps_s.any():
            raise SourceError(f"the images on {depth.topic} have no time stamps in their headers")
        depth.waiting.clear()
        return lens, color_lens, stamps_s

    def read(self, timeout_s: float) -> Images | None:
        """Return the next depth image with its colour; None if none is complete in time."""
        if not self._is_complete():
            self._waiter.wait(timeout_s)
            for stream in filter(None, (self._depth, self._color)):
                stream.take()
        if not self._is_complete():
            return None
        message = self._depth.waiting.popleft()
        color = self._partner(message.stamp_s)
        self._number += max(1, round((message.stamp_s - self._last_s) * self.rate_hz)) if self._number else 1
        self._last_s = message.stamp_s
        depth = self._lens.rectify(message.image(self._depth.kind).depth(self._depth.shape, copy=False))
        return Images(self._number, depth, color, message.stamp_s)

    def _is_complete(self) -> bool:
        """Whether the oldest depth image waits for nothing, since no colour nearer to it can come."""
        if not self._depth.waiting:
            return False
        oldest = self._depth.waiting[0]
        if self._color is None or time.monotonic() - oldest.arrival_s > _PATIENCE_S:
            return True
        return bool(self._color.waiting) and self._color.waiting[-1].stamp_s >= oldest.stamp_s

    def _partner(self, stamp_s: float) -> Uint8Array | None:
        """Return the colour image nearest in time, at most half a period apart; forget those before it."""
        if self._color is None or self._color_lens is None:
            return None
        waiting = self._color.waiting
        while len(waiting) > 1 and abs(waiting[1].stamp_s - stamp_s) <= abs(waiting[0].stamp_s - stamp_s):
            waiting.popleft()
        if not waiting or abs(waiting[0].stamp_s - stamp_s) > 0.5 / self.rate_hz * (1 + 1e-6):
            return None
        return self._color_lens.rectify(waiting[0].image(self._color.kind).color(self._color.shape, copy=False))
