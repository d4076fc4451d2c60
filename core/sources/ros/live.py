"""Live ROS 2 topics as cameras: all that have a ROS 2 driver, without a ROS installation.

A camera is what publishes a topic of depth images. Threads, pairing and reopening are those of all live cameras.
"""

from __future__ import annotations

import os
import time
from collections import deque
from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import Any, Final
from urllib.parse import parse_qsl

import numpy as np

from ...errors import SourceError, as_sentence, closed_on_error, foreign
from ...model.arrays import AnyArray, Int64Array, Uint8Array
from ...preset import CamerasSection
from ..base import CameraRole, FrameSource, Health, Progress
from ..cameras.camera import Camera, CameraDriver, DeviceInfo, Images
from ..cameras.camera_source import CameraSource
from ..cameras.pairing import Timed, period_s
from ..capture.process_source import ProcessSource
from ..lens_files import camera_info_lens
from .dds import Listener, Reader, Waiter, check_network, keep_freed_memory
from .messages import CAMERA_INFO, IMAGE, TRANSFORMS, TYPES, Bag, stamp_ns
from .recording import NAMING, GapError, StatedCamera, StatedRig, Stream, stated_rig
from .topics import COMPRESSED, ImageTopic, Topics, list_topics, split_name, survey

#: Longest search, seconds, and in how many looks nothing new may come before it ends: a busy computer looks rarely.
_SEARCH_S: Final = 6.0
_QUIET_LOOKS: Final = 20
_POLL_S: Final = 0.05
#: Types of messages; the first message of a topic tells size, encoding and lens.
_KINDS: Final = (IMAGE, COMPRESSED, CAMERA_INFO)
#: How long `cameras_here` listens, seconds: images come at least every 0.2 s.
_LOOK_S: Final = 2.0


def find_topics(name: str, listener: Listener, chosen: Topics, progress: Progress) -> StatedRig:
    """Listen until the topics of the cameras are known; `SourceError` names the source and says what was heard."""
    heard = _Heard(listener)
    began_s, quiet = time.monotonic(), 0
    found, gap = None, "no topic has depth images"
    while (spent_s := time.monotonic() - began_s) < _SEARCH_S and (
        found is None or (found.lacks and heard.silent) or quiet < _QUIET_LOOKS
    ):
        progress(0.2 * spent_s / _SEARCH_S, "looking for ROS 2 topics")
        quiet += 1
        if heard.listen():
            quiet = 0
            try:
                found = stated_rig(heard, survey(heard), heard.announced, chosen)
            except GapError as error:
                found, gap = None, str(error)
        time.sleep(_POLL_S)
    if found is not None:
        return found
    if not heard.announced:
        raise SourceError(
            f"{name}: nobody has published in ROS 2 domain {listener.domain} for {_SEARCH_S:.0f} s; start the camera's "
            "ROS 2 driver, name its domain as in ros2:?domain=3, and check that the network lets UDP through"
        )
    silent = [foreign(topic, 60) for topic in heard.silent]
    raise SourceError(
        f"{name}: {gap} in ROS 2 domain {listener.domain}; name topics, or a file of a lens, with {NAMING}; "
        f"{list_topics(survey(heard), heard.types)}"
        + (f"; without messages so far: {', '.join(silent[:8])}" if silent else "")
    )


class _Heard(Bag):
    """The first usable message of each topic of cameras, and all fixed transforms, as a recording would hold them."""

    def __init__(self, listener: Listener) -> None:
        super().__init__()
        self.announced: dict[str, str] = {}
        self._listener = listener
        self._readers: dict[str, Reader] = {}
        self._messages: dict[str, list[bytes]] = {}

    def listen(self) -> bool:
        """Take what has come since; return whether there is anything new."""
        before, self.announced = self.announced, self._listener.topics()
        is_new = self.announced != before
        for topic, kind in self.announced.items():
            is_fixed = kind == TRANSFORMS and topic.endswith("tf_static")
            if topic not in self._readers and topic not in self.types and (is_fixed or kind in _KINDS):
                self._readers[topic] = self._listener.read(topic, kind)
        for topic, reader in list(self._readers.items()):
            if messages := reader.take():
                is_new = True
                kind = self.types[topic] = self.announced.get(topic, "")
                if kind not in _KINDS:
                    self._messages.setdefault(topic, []).extend(messages)
                    continue
                self._messages[topic] = messages[-1:]
                if kind != CAMERA_INFO or self.message(topic, 0).k[0]:  # else the driver is not ready yet
                    del self._readers[topic]
        return is_new

    @property
    def silent(self) -> list[str]:
        """Announced topics of images and lenses that have sent no message yet."""
        return sorted(topic for topic, kind in self.announced.items() if kind in _KINDS and topic not in self.types)

    def count(self, topic: str) -> int:
        return len(self._messages.get(topic, ()))

    def raw(self, topic: str, index: int) -> memoryview:
        return memoryview(self._messages[topic][index])

    def times_ns(self, topic: str) -> Int64Array:
        return np.zeros(self.count(topic), np.int64)

    def close(self) -> None:
        self._readers.clear()


_ANY_NETWORK: Final = "0.0.0.0"  # noqa: S104  # ROS 2 listens to all
#: Longest wait for the first images of a camera, seconds; below that after which a driver counts as hung.
_OPENING_S: Final = 2.5
#: Depth images whose stamps tell the rate.
_TIMED: Final = 8
#: How long a depth image waits for its colour, seconds.
_PATIENCE_S: Final = 0.15
#: Where the stamp of a message ends, in CDR.
_STAMP_END: Final = 12


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
    with closed_on_error(listener.close):
        return Ros2Source(name, listener, find_topics(name, listener, chosen, progress), cameras, progress)


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
        options = parse_qsl(query.removeprefix("?"), keep_blank_values=True)
        given = dict(options)
        if given.keys() - values or len(given) < len(options) or (query and not query.startswith("?")):
            raise ValueError("the only options are domain and host, each once, as in ros2:?domain=3&host=127.0.0.1")
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
        self, name: str, listener: Listener, rig: StatedRig, cameras: CamerasSection, progress: Progress
    ) -> None:
        self._listener, self._lacks = listener, rig.lacks
        driver = Ros2Driver(listener, rig)
        chosen: dict[str, Any] = {
            role: getattr(cameras, role).model_copy(update={"serial": camera.depth.topic.name, "options": {}})
            for role, camera in rig.cameras.items()
        }
        roles = tuple(rig.cameras)
        super().__init__([driver], cameras.model_copy(update=chosen), progress, name=name, roles=roles)
        if rig.pose is not None:  # a rig of one camera has a pose already
            self.rig = self.rig.model_copy(update={"T_proximity_tactile": rig.pose})

    def health(self) -> Health:
        health = super().health()
        return replace(health, message=" ".join(filter(None, [health.message, *map(as_sentence, self._lacks)])))

    def close(self) -> None:
        super().close()
        self._listener.close()


class _TopicInfo(DeviceInfo):
    @property
    def title(self) -> str:
        return f"camera {self.serial}"


class Ros2Driver(CameraDriver):
    """The cameras of a domain, with topics of depth as serial numbers."""

    title = "ROS 2"

    def __init__(self, listener: Listener, stated: StatedRig) -> None:
        self._listener, self._cameras = listener, stated.cameras

    def devices(self) -> list[DeviceInfo]:
        return [self._info(role) for role in self._cameras]

    def open(self, serial: str, role: CameraRole) -> Camera:
        return Ros2Camera(self._listener, self._info(role), role, self._cameras[role])

    def _info(self, role: CameraRole) -> _TopicInfo:
        camera = self._cameras[role]
        return _TopicInfo(camera.calibration.depth.model, camera.depth.topic.name, role)


class _Receiver:
    """Receives the images of a topic."""

    def __init__(self, listener: Listener, stream: Stream, camera: str) -> None:
        self.stream, self._camera = stream, camera
        self.reader = listener.read(stream.topic.name, stream.topic.type)
        self.waiting: deque[Timed[bytes]] = deque()  # images that are still in CDR
        self._infos = listener.read(stream.info, CAMERA_INFO) if stream.info else None
        self._known_lens = b""

    def take(self) -> None:
        """Add the images that have come to those that wait; refuse another lens, of a camera that was exchanged."""
        topic = self.stream.topic
        for data in [] if self._infos is None else self._infos.take():
            if data[_STAMP_END:] == self._known_lens:
                continue
            info = TYPES.deserialize_cdr(data, CAMERA_INFO)
            try:
                lens = camera_info_lens(info, is_rectified=topic.is_rectified)
            except SourceError as error:
                raise SourceError(f"{topic.name}: {error}") from error
            if lens is not None and lens.intrinsics != self.stream.lens.intrinsics:
                raise SourceError(f"the {self._camera} has another lens than before: open the topics again")
            self._known_lens = data[_STAMP_END:]
        for data in self.reader.take():
            self.waiting.append(Timed(1e-9 * stamp_ns(data), time.monotonic(), data))

    def pixels(self, message: Timed[bytes]) -> AnyArray:
        data = memoryview(message.item)  # bytes would be copied
        return self.stream.pixels(TYPES.deserialize_cdr(data, self.stream.topic.type), copy=False)


class Ros2Camera(Camera):
    """Depth and colour images of one camera, paired by their stamps."""

    def __init__(self, listener: Listener, info: DeviceInfo, role: CameraRole, stated: StatedCamera) -> None:
        self._depth = _Receiver(listener, stated.depth, info.title)
        self._color = None if stated.color is None else _Receiver(listener, stated.color, info.title)
        self._streams = [stream for stream in (self._depth, self._color) if stream is not None]
        self._waiter = Waiter(listener, [stream.reader for stream in self._streams])
        self._number, self._last_s = 0, 0.0
        super().__init__(info, role, stated.calibration, self._wait_for_rate_hz(info))

    def _wait_for_rate_hz(self, info: DeviceInfo) -> float:
        """Return the rate of the first depth images by their stamps."""
        depth, name = self._depth, self._depth.stream.topic.name
        end_s = time.monotonic() + _OPENING_S
        while len(depth.waiting) < _TIMED:
            self._waiter.wait(0.05)
            self._take()
            if time.monotonic() > end_s:
                if not depth.reader.entity.get_matched_publications():
                    raise SourceError(f"nobody publishes {name}; start the camera's ROS 2 driver")
                raise SourceError(f"the {info.title} has sent only {len(depth.waiting)} images in {_OPENING_S:g} s")
        stamps_s = np.array([message.time_s for message in depth.waiting])
        if not stamps_s.any():
            raise SourceError(f"the images on {name} have no time stamps in their headers")
        for stream in self._streams:
            if stream.waiting:
                stream.pixels(stream.waiting[-1])  # what cannot be read is told before the camera counts as open
        depth.waiting.clear()
        return round(1 / period_s(stamps_s), 1)

    def read(self, timeout_s: float) -> Images | None:
        """Return the next depth image with its colour; None if none is complete in time."""
        if not self._is_complete():
            self._waiter.wait(timeout_s)
            self._take()
        if not self._is_complete():
            return None
        message = self._depth.waiting.popleft()
        color = self._partner(message.time_s)
        self._number += max(1, round((message.time_s - self._last_s) * self.rate_hz)) if self._number else 1
        self._last_s = message.time_s
        return Images(self._number, self._depth.pixels(message), color, message.time_s)

    def _take(self) -> None:
        for stream in self._streams:
            stream.take()

    def _is_complete(self) -> bool:
        """Whether the oldest depth image waits for nothing, since no colour nearer to it can come."""
        if not self._depth.waiting:
            return False
        oldest = self._depth.waiting[0]
        if self._color is None or time.monotonic() - oldest.arrival_s > _PATIENCE_S:
            return True
        return bool(self._color.waiting) and self._color.waiting[-1].time_s >= oldest.time_s

    def _partner(self, stamp_s: float) -> Uint8Array | None:
        """Return the colour image nearest in time, at most half a period apart; forget those before it."""
        if self._color is None:
            return None
        waiting = self._color.waiting
        while len(waiting) > 1 and abs(waiting[1].time_s - stamp_s) <= abs(waiting[0].time_s - stamp_s):
            waiting.popleft()
        if not waiting or abs(waiting[0].time_s - stamp_s) > 0.5 / self.rate_hz * (1 + 1e-6):
            return None
        return self._color.pixels(waiting[0])
