"""Live connections: processed frames as messages, to whoever listens.

The `Publisher` takes each processed frame. A `Sink` is one way out, such as a Foxglove server or ROS 2. Each has its
own thread, which takes the newest frame from a mailbox with one slot: a slow sink loses its own frames only, and
nothing waits for it. A message is built when the first sink asks for it, once for all sinks, and only if somebody
listens to its topic.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np

from ..contact.alignment import tactile_pose
from ..contact.pipeline import ContactPatch
from ..errors import RigMismatchError
from ..model.arrays import Float64Array
from ..model.clouds import deproject_image
from ..model.frames import SensorFrame
from ..model.patch import Lazy
from ..model.rig_file import json_text, rig_to_json
from ..preset import Preset
from ..sources.mcap.messages import (
    CAMERA_INFO,
    IMAGE,
    OBJECT_FRAME,
    POINT_CLOUD,
    TACTILE_FRAME,
    TEXT,
    TRANSFORMS,
    Topic,
)
from . import messages
from .messages import DIAGNOSTICS, NUMBER, POSE, VECTOR

_IMAGES: Final = (Topic.PROXIMITY_DEPTH, Topic.PROXIMITY_COLOR, Topic.TACTILE_DEPTH, Topic.TACTILE_COLOR)

#: Message type of every topic of a live connection.
LIVE_TOPICS: Final[Mapping[str, str]] = {
    Topic.PATCH: POINT_CLOUD,
    Topic.AREA: NUMBER,
    Topic.TILT: VECTOR,
    Topic.TILT_SIGMA: VECTOR,
    Topic.OBJECT_POSE: POSE,
    Topic.TRANSFORMS: TRANSFORMS,
    Topic.STATIC_TRANSFORMS: TRANSFORMS,
    Topic.PROXIMITY_CLOUD: POINT_CLOUD,
    Topic.TACTILE_CLOUD: POINT_CLOUD,
    **dict.fromkeys(_IMAGES, IMAGE),
    **{topic.camera_info: CAMERA_INFO for topic in _IMAGES},
    Topic.DIAGNOSTICS: DIAGNOSTICS,
    Topic.FRAME: TEXT,
    Topic.RIG: TEXT,
}

#: Topics that hardly change; they are sent again for clients that came later.
_REPEATED: Final = frozenset({Topic.STATIC_TRANSFORMS, Topic.RIG})
_REPEAT_NS: Final = 10**9

#: A source whose clock is farther than this from the computer's gets time stamps of now: a recording, a simulator.
_MAX_CLOCK_ERROR_NS: Final = 10**9


@dataclass(frozen=True, eq=False)
class LiveMessage:
    """One message on its way out.

    Attributes
    ----------
    topic : str
        Such as ``"/contact/patch"``, without a namespace.
    type : str
        ROS 2 type, such as ``"sensor_msgs/msg/PointCloud2"``.
    data : bytes
        The whole message in CDR, little-endian, with its four-byte header.
    stamp_ns : int
        When the frame was taken, nanoseconds since 1970; also in the header of messages that have one.
    """

    topic: str
    type: str
    data: bytes
    stamp_ns: int


@dataclass(frozen=True)
class SinkStatus:
    """State of a sink.

    Attributes
    ----------
    name : str
        Such as ``"Foxglove"``.
    place : str
        Where it can be reached, such as ``"ws://127.0.0.1:8765"``.
    clients : int
        Clients connected.
    """

    name: str
    place: str
    clients: int


class Sink(Protocol):
    """One way out for messages. `wanted`, `send` and `close` are called on the sink's own thread, in turn."""

    def start(self, topics: Mapping[str, str]) -> None:
        """Announce topics, given with their types, and let clients connect; called once, before everything else.

        Raises
        ------
        PublishError
            It is not possible; the message says why and what to do.
        MissingExtraError
            A package is not installed.
        """

    def wanted(self) -> Collection[str]:
        """Return the topics that somebody listens to now."""

    def send(self, messages: Sequence[LiveMessage]) -> None:
        """Send the messages of one frame, each of a wanted topic; may block."""

    def close(self) -> None:
        """Disconnect clients and free the port; twice is harmless."""

    def status(self) -> SinkStatus:
        """Return the state; called from any thread."""


@dataclass(frozen=True, eq=False)
class Estimates:
    """What was read from a patch; what is None is not published.

    Attributes
    ----------
    tilt : Lazy of a dict, optional
        As `tactune.core.estimation.tilt.Tilt.record` returns it; computed if somebody listens to it.
    pose : float64, shape (4, 4), optional
        ``T_proximity_object`` of a tracked object that is not lost.
    covariance : float64, shape (6, 6), optional
        Of that pose, as in `tactune.core.estimation.pose.PoseEstimate`.
    """

    tilt: Lazy[dict[str, Any]] | None = None
    pose: Float64Array | None = None
    covariance: Float64Array | None = None


_NO_ESTIMATES: Final = Estimates()


@dataclass(frozen=True)
class OutputStatus:
    """State of a sink and of what it got.

    Attributes
    ----------
    sink : SinkStatus
    rate_hz : float
        Frames sent in a second, over the last seconds; 0 while nobody listens.
    sent, missed : int
        Frames sent, and frames that came while the sink was still sending another.
    error : str
        Why the last frame could not be sent; empty if it was.
    """

    sink: SinkStatus
    rate_hz: float
    sent: int
    missed: int
    error: str


class FrameMessages:
    """The messages of one processed frame, each built when it is first asked for; for any thread.

    Parameters
    ----------
    frame : SensorFrame
    patch : ContactPatch
    preset : Preset
        The one that the patch was computed with.
    shift_ns : int
        Added to the frame's time stamps.
    estimates : Estimates
    """

    def __init__(
        self, frame: SensorFrame, patch: ContactPatch, preset: Preset, shift_ns: int, estimates: Estimates
    ) -> None:
        self._frame, self._patch, self._preset, self._estimates = frame, patch, preset, estimates
        self._proximity_ns = messages.nanoseconds(frame.proximity_time_s) + shift_ns
        self._tactile_ns = messages.nanoseconds(frame.tactile_time_s) + shift_ns
        self._built: dict[str, LiveMessage | None] = {}
        self._lock = threading.Lock()

    @property
    def stamp_ns(self) -> int:
        """Time stamp of the frame, nanoseconds since 1970."""
        return self._proximity_ns

    def get(self, topic: str) -> LiveMessage | None:
        """Return the message of a topic of `LIVE_TOPICS`, or None if this frame has none."""
        with self._lock:
            if topic not in self._built:
                data = self._build(topic)
                self._built[topic] = (
                    None if data is None else LiveMessage(topic, LIVE_TOPICS[topic], data, self.stamp_ns)
                )
            return self._built[topic]

    def _build(self, topic: str) -> bytes | None:
        frame, rig, stamp_ns = self._frame, self._patch.rig, self._proximity_ns
        if topic.endswith(("/image", "/camera_info")):
            return self._build_image(topic)
        build: dict[str, Callable[[], bytes | None]] = {
            Topic.PATCH: lambda: messages.point_cloud(self._patch.points, stamp_ns),
            Topic.AREA: lambda: messages.number(self._patch.area_mm2),
            Topic.TILT: lambda: self._build_tilt(""),
            Topic.TILT_SIGMA: lambda: self._build_tilt("_sigma"),
            Topic.OBJECT_POSE: self._build_pose,
            Topic.TRANSFORMS: self._build_transforms,
            Topic.STATIC_TRANSFORMS: self._build_static_transforms,
            Topic.PROXIMITY_CLOUD: lambda: messages.point_cloud(
                deproject_image(frame.proximity_depth, rig.proximity), stamp_ns
            ),
            Topic.TACTILE_CLOUD: lambda: messages.point_cloud(
                deproject_image(frame.tactile_depth, rig.tactile), self._tactile_ns, TACTILE_FRAME
            ),
            Topic.DIAGNOSTICS: self._build_diagnostics,
            Topic.FRAME: lambda: messages.frame_text(frame),
            Topic.RIG: lambda: messages.text(json_text(rig_to_json(rig))),
        }
        return build[topic]()

    def _build_image(self, topic: str) -> bytes | None:
        streams = messages.image_streams(self._patch.rig)
        image_topic = Topic(topic.replace("camera_info", "image"))
        stream = streams[image_topic]
        image = next((image for of, image in messages.images_of(self._frame) if of == image_topic), None)
        if image is None:
            return None
        stamp_ns = self._tactile_ns if stream.of_tactile else self._proximity_ns
        if topic != image_topic:
            return messages.stamped(stream.lens, stamp_ns) if stream.lens is not None else None
        stream.check(image, self._frame.sequence)
        pixels = np.ascontiguousarray(image).reshape(-1).view(np.uint8)
        return b"".join((messages.stamped(stream.head, stamp_ns), pixels.data))

    def _build_tilt(self, of: str) -> bytes | None:
        if self._estimates.tilt is None:
            return None
        tilt = self._estimates.tilt.get()
        angles = [tilt[f"{angle}{of}_rad"] for angle in ("roll", "pitch", "axis")]
        x, y, z = (math.nan if angle is None else angle for angle in angles)
        return messages.vector(x, y, z, self.stamp_ns)

    def _build_pose(self) -> bytes | None:
        pose, covariance = self._estimates.pose, self._estimates.covariance
        if pose is None or covariance is None:
            return None
        return messages.pose_with_covariance(pose, covariance, self.stamp_ns)

    def _build_transforms(self) -> bytes | None:
        pose = self._estimates.pose
        return None if pose is None else messages.transforms({OBJECT_FRAME: pose}, self.stamp_ns)

    def _build_static_transforms(self) -> bytes:
        calibrated = None
        with suppress(RigMismatchError):  # a homography needs no pose
            calibrated = tactile_pose(self._preset.alignment, self._patch.rig)
        return messages.static_transforms(self._patch.rig, self.stamp_ns, calibrated)

    def _build_diagnostics(self) -> bytes:
        patch = self._patch
        values = {f"{stage} ms": f"{ms:.3f}" for stage, ms in patch.stage_ms.items()}
        values |= {
            "frame": str(patch.sequence),
            "total ms": f"{sum(patch.stage_ms.values()):.3f}",
            "points": str(len(patch.points)),
            "skew ms": f"{1e3 * self._frame.skew_s:.3f}",
        }
        return messages.diagnostics("tactune", values, self.stamp_ns)


class Publisher:
    """Gives every processed frame to sinks. A context manager.

    Parameters
    ----------
    sinks : sequence of Sink

    Raises
    ------
    PublishError, MissingExtraError
        A sink cannot start; those before it are closed again.
    """

    def __init__(self, sinks: Sequence[Sink]) -> None:
        self._shift_ns = 0
        self._outputs: list[_Output] = []
        try:
            for sink in sinks:
                sink.start(LIVE_TOPICS)
                self._outputs.append(_Output(sink))
        except BaseException:
            self.close()
            raise

    def put(
        self, frame: SensorFrame, patch: ContactPatch, preset: Preset, estimates: Estimates = _NO_ESTIMATES
    ) -> None:
        """Publish a frame and return at once.

        Parameters
        ----------
        frame : SensorFrame
            Its images must not be overwritten.
        patch : ContactPatch
        preset : Preset
            The one that the patch was computed with.
        estimates : Estimates
        """
        now_ns, stamp_ns = time.time_ns(), messages.nanoseconds(frame.proximity_time_s)
        if abs(stamp_ns + self._shift_ns - now_ns) > _MAX_CLOCK_ERROR_NS:
            is_live = abs(stamp_ns - now_ns) < _MAX_CLOCK_ERROR_NS
            self._shift_ns = 0 if is_live else now_ns - stamp_ns
        elif self._shift_ns:  # a frame that took less time than those before: no stamp lies in the future
            self._shift_ns = min(self._shift_ns, now_ns - stamp_ns)
        built = FrameMessages(frame, patch, preset, self._shift_ns, estimates)
        for output in self._outputs:
            output.put(built)

    def status(self) -> tuple[OutputStatus, ...]:
        """Return the state of every sink."""
        return tuple(output.status() for output in self._outputs)

    def close(self) -> None:
        """Close all sinks; twice is harmless."""
        while self._outputs:
            self._outputs.pop().close()

    def __enter__(self) -> Publisher:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Output:
    """A started sink, its thread and the mailbox between them."""

    def __init__(self, sink: Sink) -> None:
        self._sink = sink
        self._changed = threading.Condition()
        self._waiting: FrameMessages | None = None
        self._closing = False
        self._sent = self._missed = 0
        self._times_s: list[float] = []
        self._error = ""
        self._repeated_ns: dict[str, int] = {}
        self._thread = threading.Thread(target=self._run, name=f"publish {sink.status().name}", daemon=True)
        self._thread.start()

    def put(self, frame: FrameMessages) -> None:
        """Replace the frame in the mailbox."""
        with self._changed:
            self._missed += self._waiting is not None
            self._waiting = frame
            self._changed.notify()

    def status(self) -> OutputStatus:
        """Return the state."""
        with self._changed:
            times_s = [time_s for time_s in self._times_s if time_s > time.monotonic() - _RATE_OVER_S]
            return OutputStatus(self._sink.status(), len(times_s) / _RATE_OVER_S, self._sent, self._missed, self._error)

    def close(self) -> None:
        """Stop the thread and close the sink."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(_CLOSE_S)

    def _run(self) -> None:
        while (frame := self._next()) is not None:
            try:
                self._send(frame)
            except Exception as error:  # nobody can catch an exception of this thread, and the next frame may pass
                with self._changed:
                    self._error = str(error) or type(error).__name__
        self._sink.close()

    def _next(self) -> FrameMessages | None:
        with self._changed:
            self._changed.wait_for(lambda: self._closing or self._waiting is not None)
            frame, self._waiting = self._waiting, None
            return None if self._closing else frame

    def _send(self, frame: FrameMessages) -> None:
        wanted = [topic for topic in self._sink.wanted() if self._is_due(topic, frame.stamp_ns)]
        found = [message for topic in wanted if (message := frame.get(topic)) is not None]
        if not found:
            return
        self._sink.send(found)
        with self._changed:
            self._sent += 1
            self._error = ""
            self._times_s = [*self._times_s[-_RATE_FRAMES:], time.monotonic()]

    def _is_due(self, topic: str, stamp_ns: int) -> bool:
        if topic not in _REPEATED:
            return True
        if abs(stamp_ns - self._repeated_ns.get(topic, 0)) < _REPEAT_NS:
            return False
        self._repeated_ns[topic] = stamp_ns
        return True


#: The rate is that of the last seconds, from at most this many frames.
_RATE_OVER_S: Final = 2.0
_RATE_FRAMES: Final = 1000
#: Longest wait for a sink that is still sending when it is closed.
_CLOSE_S: Final = 5.0
