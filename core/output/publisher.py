"""Live connections: processed frames as messages, to whoever listens.

Each `Sink` has its own thread, which takes the newest frame and the newest pose from a mailbox with one slot for each:
a slow sink loses its own frames only, and nothing waits for it. A message is built once for all sinks, and only if
somebody listens to its topic.
"""

from __future__ import annotations

import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, Protocol

from ..contact.alignment import tactile_pose
from ..contact.pipeline import ContactPatch
from ..errors import RigMismatchError, closed_on_error
from ..model.arrays import AnyArray, Float64Array, Uint16Array
from ..model.clouds import deproject_image
from ..model.files import Closing
from ..model.frames import DepthCamera, SensorFrame
from ..model.patch import Lazy
from ..model.rig_file import json_text, rig_to_json
from ..preset import Preset
from ..sources.ros import messages as ros
from ..sources.ros.messages import Topic
from . import messages
from .messages import DIAGNOSTICS, FORCE_TOPICS, PATCH_TOPICS, POSE_TOPICS, VECTOR

_IMAGES: Final = (Topic.PROXIMITY_DEPTH, Topic.PROXIMITY_COLOR, Topic.TACTILE_DEPTH, Topic.TACTILE_COLOR)

#: Message type of every topic of a live connection.
LIVE_TOPICS: Final[Mapping[str, str]] = {
    **PATCH_TOPICS,
    **FORCE_TOPICS,
    Topic.TILT: VECTOR,
    Topic.TILT_SIGMA: VECTOR,
    **POSE_TOPICS,
    Topic.STATIC_TRANSFORMS: ros.TRANSFORMS,
    Topic.PROXIMITY_CLOUD: ros.POINT_CLOUD,
    Topic.TACTILE_CLOUD: ros.POINT_CLOUD,
    **dict.fromkeys(_IMAGES, ros.IMAGE),
    **{topic.camera_info: ros.CAMERA_INFO for topic in _IMAGES},
    Topic.DIAGNOSTICS: DIAGNOSTICS,
    Topic.FRAME: ros.TEXT,
    Topic.RIG: ros.TEXT,
}

#: Topics that hardly change; they are sent again for clients that came later.
_REPEATED: Final = frozenset({Topic.STATIC_TRANSFORMS, Topic.RIG})
_REPEAT_NS: Final = 10**9

#: A source whose clock is farther than this from the computer's gets time stamps of now: a recording, a simulator.
_MAX_CLOCK_ERROR_NS: Final = 10**9

#: The rate is that of the last seconds, from at most this many frames.
_RATE_OVER_S: Final = 2.0
_RATE_FRAMES: Final = 2000
#: Longest wait for a sink that is still sending when it is closed.
_CLOSE_S: Final = 5.0
#: Frames whose time stamps are kept for poses that come later.
_KEPT_STAMPS: Final = 100


@dataclass(frozen=True, eq=False)
class LiveMessage:
    """One message on its way out: ``data`` is all of it in CDR, little-endian, with its four-byte header.

    ``topic`` is without a namespace; ``stamp_ns`` says when the frame was taken, nanoseconds since 1970.
    """

    topic: str
    data: bytes
    stamp_ns: int


@dataclass(frozen=True)
class SinkStatus:
    """State of a sink: its name, where it can be reached, such as ``"ws://127.0.0.1:8765"``, and its clients."""

    name: str
    place: str
    clients: int


class Sink(Protocol):
    """One way out for messages. All but `start` and `status` are called on the sink's own thread, in turn."""

    def start(self) -> None:
        """Let clients connect; called once, before everything else.

        Raises `PublishError` where that is not possible, `MissingExtraError` where a package is not installed.
        """

    def announce(self, topics: Mapping[str, str]) -> None:
        """Announce further topics, given with their types."""

    def wanted(self) -> Collection[str]:
        """Return the topics that somebody listens to now."""

    def send(self, messages: Sequence[LiveMessage]) -> None:
        """Send the messages of one frame, each of a wanted topic; may block."""

    def close(self) -> None:
        """Disconnect clients and free the port; twice is harmless."""

    def status(self) -> SinkStatus:
        """Return the state; called from any thread."""


@dataclass(frozen=True)
class OutputStatus:
    """State of a sink: the rate of frames (of poses where clients listen to these only) over the last seconds.

    ``missed`` counts frames and poses that came while the sink was still sending another; ``error`` says why the last
    frame could not be sent.
    """

    sink: SinkStatus
    rate_hz: float
    missed: int
    error: str


class Messages:
    """The messages of one frame, or of one pose, each built when it is first asked for; for any thread.

    A builder returns the bytes of its topic's message, or None if there is none this time.
    """

    def __init__(self, builders: Mapping[str, Callable[[], bytes | None]], stamp_ns: int) -> None:
        self.parts, self.stamp_ns = {topic: Lazy(build) for topic, build in builders.items()}, stamp_ns

    def get(self, topic: str) -> LiveMessage | None:
        """Return the message of one of the topics, or None if there is none this time."""
        data = self.parts[topic].get()
        return None if data is None else LiveMessage(topic, data, self.stamp_ns)


def frame_messages(
    frame: SensorFrame,
    patch: ContactPatch,
    preset: Preset,
    shift_ns: int,
    tilt: Lazy[dict[str, Any]] | None = None,
) -> Messages:
    """Return the messages of a frame; ``shift_ns`` is added to its stamps."""
    rig = patch.rig
    stamp_ns, tactile_ns = (
        messages.nanoseconds(time_s) + shift_ns for time_s in (frame.proximity_time_s, frame.tactile_time_s)
    )

    def transforms() -> bytes:
        calibrated = None
        with suppress(RigMismatchError):  # a homography needs no pose
            calibrated = tactile_pose(preset.alignment, rig)
        return messages.static_transforms(rig, stamp_ns, calibrated)

    def angles(tilt: Lazy[dict[str, Any]], of: str) -> bytes:
        found = [tilt.get()[f"{angle}{of}_rad"] for angle in ("roll", "pitch", "axis")]
        roll, pitch, axis = (math.nan if angle is None else angle for angle in found)
        return messages.vector(roll, pitch, axis, stamp_ns)

    def diagnostics() -> bytes:
        values = {f"{stage} ms": f"{ms:.3f}" for stage, ms in patch.stage_ms.items()} | {
            "frame": str(patch.sequence),
            "total ms": f"{sum(patch.stage_ms.values()):.3f}",
            "points": str(len(patch.points)),
            "skew ms": f"{1e3 * frame.skew_s:.3f}",
        }
        return messages.diagnostics("tactune", values, stamp_ns)

    def cloud(counts: Uint16Array, camera: DepthCamera, time_ns: int, frame_id: str) -> bytes:
        return messages.point_cloud(deproject_image(counts, camera), time_ns, frame_id)

    def image(stream: messages.ImageStream, pixels: AnyArray, time_ns: int) -> bytes:
        return b"".join(stream.parts(pixels, frame.sequence, time_ns))

    builders: dict[str, Callable[[], bytes | None]] = {
        **messages.patch_builders(patch, stamp_ns),
        Topic.STATIC_TRANSFORMS: transforms,
        Topic.TACTILE_CLOUD: lambda: cloud(frame.tactile_depth, rig.tactile, tactile_ns, ros.TACTILE_FRAME),
        Topic.DIAGNOSTICS: diagnostics,
        Topic.FRAME: lambda: messages.frame_text(frame),
        Topic.RIG: lambda: messages.text(json_text(rig_to_json(rig))),
    }
    if tilt is not None:
        builders |= {Topic.TILT: partial(angles, tilt, ""), Topic.TILT_SIGMA: partial(angles, tilt, "_sigma")}
    if rig.has_proximity:
        builders[Topic.PROXIMITY_CLOUD] = lambda: cloud(
            frame.proximity_depth, rig.proximity, stamp_ns, ros.PROXIMITY_FRAME
        )
    streams = messages.image_streams(rig)
    for topic, pixels in messages.images_of(frame, rig):
        stream = streams[topic]
        time_ns = tactile_ns if stream.of_tactile else stamp_ns
        if stream.lens is not None:  # truth has none, and is no topic of a live connection
            builders[topic] = partial(image, stream, pixels, time_ns)
            builders[topic.camera_info] = partial(messages.stamped, stream.lens, time_ns)
    return Messages(builders, stamp_ns)


class Publisher(Closing):
    """Gives every processed frame to sinks. A context manager.

    Raises `PublishError` or `MissingExtraError` where a sink cannot start; those before it are closed again.
    """

    def __init__(self, sinks: Sequence[Sink]) -> None:
        self._shift_ns = 0
        self._stamps_ns: dict[float, int] = {}
        self._outputs: list[_Output] = []
        with closed_on_error(self.close):
            for sink in sinks:
                sink.start()
                self._outputs.append(_Output(sink))

    def put(
        self,
        frame: SensorFrame,
        patch: ContactPatch,
        preset: Preset,
        tilt: Lazy[dict[str, Any]] | None = None,
    ) -> None:
        """Publish a frame and return at once.

        Parameters
        ----------
        frame : SensorFrame
            Its images must not be overwritten.
        patch : ContactPatch
        preset : Preset
            That of the patch.
        tilt : Lazy, optional
            What `Tilt.record` returns; computed if somebody listens to it.
        """
        now_ns, stamp_ns = time.time_ns(), messages.nanoseconds(frame.proximity_time_s)
        if abs(stamp_ns + self._shift_ns - now_ns) > _MAX_CLOCK_ERROR_NS:
            is_live = abs(stamp_ns - now_ns) < _MAX_CLOCK_ERROR_NS
            self._shift_ns = 0 if is_live else now_ns - stamp_ns
        elif self._shift_ns:  # a frame that took less time than those before: no stamp lies in the future
            self._shift_ns = min(self._shift_ns, now_ns - stamp_ns)
        built = frame_messages(frame, patch, preset, self._shift_ns, tilt)
        self._stamps_ns.pop(frame.proximity_time_s, None)  # of a recording that begins again
        self._stamps_ns[frame.proximity_time_s] = built.stamp_ns
        if len(self._stamps_ns) > _KEPT_STAMPS:
            del self._stamps_ns[next(iter(self._stamps_ns))]
        for output in self._outputs:
            output.put("frame", built)

    def put_pose(self, pose: Float64Array, covariance: Float64Array, time_s: float) -> None:
        """Publish the pose of a tracked object that is not lost, and return at once; for any thread.

        Parameters
        ----------
        pose : float64, shape (4, 4)
            ``T_proximity_object``.
        covariance : float64, shape (6, 6)
            Of x, y, z in metres and small rotations about the fixed axes in radians.
        time_s : float
            Proximity time stamp of its frame, which must be among the newest 100 of `put`.
        """
        stamp_ns = self._stamps_ns.get(time_s)
        if stamp_ns is not None:
            parts = messages.pose_parts(pose, covariance, stamp_ns)
            built = Messages({topic: partial(parts.get, topic) for topic in parts}, stamp_ns)
            for output in self._outputs:
                output.put("pose", built)

    def status(self) -> tuple[OutputStatus, ...]:
        """Return the state of every sink."""
        return tuple(output.status() for output in self._outputs)

    def close(self) -> None:
        """Close all sinks; twice is harmless."""
        while self._outputs:
            self._outputs.pop().close()


class _Output:
    """A started sink, its thread and the mailbox between them."""

    def __init__(self, sink: Sink) -> None:
        self.sink = sink
        self._changed = threading.Condition()
        self._waiting: dict[str, Messages] = {}  # "frame" and "pose"
        self._announced: set[str] = set()
        self._closing = False
        self._missed = 0
        self._sent_s: deque[tuple[str, float]] = deque(maxlen=_RATE_FRAMES)
        self._error = ""
        self._repeated_ns: dict[str, int] = {}
        self._thread = threading.Thread(target=self._run, name=f"publish {sink.status().name}", daemon=True)
        self._thread.start()

    def put(self, kind: str, built: Messages) -> None:
        with self._changed:
            self._missed += kind in self._waiting
            self._waiting[kind] = built
            self._changed.notify()

    def status(self) -> OutputStatus:
        with self._changed:
            since_s = time.monotonic() - _RATE_OVER_S
            recent = Counter(kind for kind, time_s in self._sent_s if time_s > since_s)
            rate_hz = max(recent.values(), default=0) / _RATE_OVER_S
            return OutputStatus(self.sink.status(), rate_hz, self._missed, self._error)

    def close(self) -> None:
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(_CLOSE_S)

    def _run(self) -> None:
        while (waiting := self._next()) is not None:
            try:
                self._send(*waiting)
            except Exception as error:  # nobody can catch an exception of this thread, and the next frame may pass
                with self._changed:
                    self._error = str(error) or type(error).__name__
        self.sink.close()

    def _next(self) -> tuple[str, Messages] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._closing or bool(self._waiting))
            if self._closing:
                return None
            kind = next(iter(self._waiting))
            return kind, self._waiting.pop(kind)

    def _send(self, kind: str, built: Messages) -> None:
        if new := {topic: LIVE_TOPICS[topic] for topic in built.parts if topic not in self._announced}:
            self.sink.announce(new)
            self._announced |= new.keys()
        wanted = [topic for topic in self.sink.wanted() if topic in built.parts]
        due = [topic for topic in wanted if self._is_due(topic, built.stamp_ns)]
        found = [message for topic in due if (message := built.get(topic)) is not None]
        if not found:
            return
        self.sink.send(found)
        with self._changed:
            self._error = ""
            self._sent_s.append((kind, time.monotonic()))

    def _is_due(self, topic: str, stamp_ns: int) -> bool:
        if topic not in _REPEATED:
            return True
        if abs(stamp_ns - self._repeated_ns.get(topic, 0)) < _REPEAT_NS:
            return False
        self._repeated_ns[topic] = stamp_ns
        return True
