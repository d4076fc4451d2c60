"""ROS 2 messages for recordings, Foxglove and ROS 2: whole ones, little-endian, with the four-byte header of CDR."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from ..errors import FrameError
from ..model.arrays import AnyArray, Float32Array, Float64Array
from ..model.frames import Rig, SensorFrame
from ..model.intrinsics import Intrinsics
from ..model.patch import ContactPatch
from ..preset import Preset
from ..sources.ros import messages as ros
from ..sources.ros.messages import Topic

POSE: Final = "geometry_msgs/msg/PoseWithCovarianceStamped"
VECTOR: Final = "geometry_msgs/msg/Vector3Stamped"
WRENCH: Final = "geometry_msgs/msg/WrenchStamped"
MARKER: Final = "visualization_msgs/msg/Marker"
NUMBER: Final = "std_msgs/msg/Float64"
DIAGNOSTICS: Final = "diagnostic_msgs/msg/DiagnosticArray"

#: Transient local and reliable, in the numbers that every release of rosbag2 understands; without
#: this, players publish static transforms with settings that subscribers refuse.
STATIC_QOS: Final = """\
- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: 1
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
"""

#: Width of an arrow's shaft, width and length of its head, metres, and its colour.
_ARROW_M: Final = (0.004, 0.01, 0.012)
_ARROW_RGBA: Final = (0.1, 0.45, 0.88, 1.0)

#: Topics with one message, which players keep for late subscribers.
SAID_ONCE: Final = (Topic.RIG, Topic.STATIC_TRANSFORMS)

#: Types of the topics of a patch, and of those of a force, which the pressure test alone has.
PATCH_TOPICS: Final[dict[str, str]] = {Topic.PATCH: ros.POINT_CLOUD, Topic.AREA: NUMBER, Topic.DOUBT: DIAGNOSTICS}
FORCE_TOPICS: Final[dict[str, str]] = {Topic.WRENCH: WRENCH, Topic.RELATIVE_FORCE: VECTOR, Topic.FORCE_ARROW: MARKER}

#: Types of the topics of a tracked object.
POSE_TOPICS: Final[dict[str, str]] = {Topic.OBJECT_POSE: POSE, Topic.TRANSFORMS: ros.TRANSFORMS}

#: Topics that ROS 2 keeps out of namespaces.
_GLOBAL_TOPICS: Final = (Topic.TRANSFORMS, Topic.STATIC_TRANSFORMS)

#: Type and number of channels of each encoding.
_PIXELS: Final[dict[str, tuple[np.dtype[Any], int]]] = {
    "16UC1": (np.dtype("<u2"), 1),
    "rgb8": (np.dtype("u1"), 3),
    "mono8": (np.dtype("u1"), 1),
    "32FC1": (np.dtype("<f4"), 1),
}


def ros_topic(topic: str, namespace: str) -> str:
    """Return a topic's name in ROS 2; a namespace replaces ``/tactune`` at the start of a topic."""
    if topic in _GLOBAL_TOPICS or not namespace:
        return topic
    return f"/{namespace}{topic.removeprefix('/tactune')}"


def nanoseconds(time_s: float) -> int:
    return round(time_s * 1e9)


class LogClock:
    """Log times that follow the stamps and always increase, since players sort by them, also if a clock jumps back.

    They increase by a thousandth of the period or more: seconds since the first frame tell them apart after decades.
    """

    def __init__(self, period_s: float) -> None:
        self._period_ns = max(nanoseconds(period_s), 1)
        self._shift_ns, self._last_ns = 0, -self._period_ns

    def tick(self, stamp_ns: int) -> int:
        """Return the log time of a frame with this stamp, nanoseconds from 0."""
        if stamp_ns + self._shift_ns <= max(self._last_ns + self._period_ns // 1000, -1):
            self._shift_ns = self._last_ns + self._period_ns - stamp_ns
        self._last_ns = stamp_ns + self._shift_ns
        return self._last_ns


def definition(message_type: str) -> str:
    return ros.TYPES.generate_msgdef(message_type, ros_version=2)[0]


def type_hash(message_type: str) -> str:
    """Return the hash by which ROS 2 identifies this definition."""
    return ros.TYPES.hash_rihs01(message_type)


def stamped(template: bytes, stamp_ns: int) -> bytes:
    """Return a serialised message, whose first field is a header, with another time stamp."""
    seconds, rest = divmod(stamp_ns, 10**9)
    return template[:4] + struct.pack("<iI", seconds, rest) + template[12:]


def camera_info(frame_id: str, lens: Intrinsics) -> bytes:
    k = lens.camera_matrix()
    return _message(
        ros.CAMERA_INFO,
        header=_header(frame_id),
        height=lens.height,
        width=lens.width,
        distortion_model="plumb_bob",
        d=np.array(lens.coefficients),
        k=k.ravel(),
        r=np.eye(3).ravel(),
        p=np.hstack([k, np.zeros((3, 1))]).ravel(),
        binning_x=0,
        binning_y=0,
        roi=_type("sensor_msgs/msg/RegionOfInterest")(0, 0, 0, 0, False),
    )


def static_transforms(rig: Rig, stamp_ns: int, T_proximity_tactile: Float64Array | None = None) -> bytes:
    """Return the poses of the cameras in the proximity depth frame; a calibrated one replaces the rig's."""
    poses: dict[str, Float64Array] = {}
    if T_proximity_tactile is not None:
        poses[ros.TACTILE_FRAME] = T_proximity_tactile
    elif rig.T_proximity_tactile is not None:
        poses[ros.TACTILE_FRAME] = np.array(rig.T_proximity_tactile)
    if rig.proximity_color is not None:
        poses[ros.PROXIMITY_COLOR_FRAME] = np.linalg.inv(np.array(rig.proximity_color.T_color_depth)).astype(np.float64)
    return transforms(poses, stamp_ns)


def transforms(poses: Mapping[str, Float64Array], stamp_ns: int) -> bytes:
    """Return poses (4 x 4) of frames, by their names, in the proximity depth frame."""
    header = _header(ros.PROXIMITY_FRAME, stamp_ns)
    stamped_pose = _type("geometry_msgs/msg/TransformStamped")
    translation, transform = _type("geometry_msgs/msg/Vector3"), _type("geometry_msgs/msg/Transform")
    found = [
        stamped_pose(header, child, transform(translation(*pose[:3, 3].tolist()), _quaternion(pose)))
        for child, pose in poses.items()
    ]
    return _message(ros.TRANSFORMS, found)


def pose_parts(pose: Float64Array, covariance: Float64Array, stamp_ns: int) -> dict[str, bytes]:
    """Return the messages of a tracked object by topic.

    Its pose, (4, 4), is in the proximity depth frame, its covariance, (6, 6): x, y, z in m, rotations about them.
    """
    point = _type("geometry_msgs/msg/Point")(*pose[:3, 3].tolist())
    body = _type("geometry_msgs/msg/Pose")(point, _quaternion(pose))
    known = _type("geometry_msgs/msg/PoseWithCovariance")(body, np.asarray(covariance, np.float64).ravel())
    return {
        Topic.OBJECT_POSE: _message(POSE, _header(ros.PROXIMITY_FRAME, stamp_ns), known),
        Topic.TRANSFORMS: transforms({ros.OBJECT_FRAME: pose}, stamp_ns),
    }


def vector(x: float, y: float, z: float, stamp_ns: int) -> bytes:
    """Return three numbers about the axes of the proximity depth frame."""
    return _message(VECTOR, _header(ros.PROXIMITY_FRAME, stamp_ns), _type("geometry_msgs/msg/Vector3")(x, y, z))


def wrench(force_n: tuple[float, float, float], place_m: Float64Array, stamp_ns: int) -> bytes:
    """Return a force that acts at a place, and its torque about the origin of the proximity depth frame, N m."""
    of = _type("geometry_msgs/msg/Vector3")
    both = _type("geometry_msgs/msg/Wrench")(of(*force_n), of(*np.cross(place_m, force_n).tolist()))
    return _message(WRENCH, _header(ros.PROXIMITY_FRAME, stamp_ns), both)


def arrow(ends_m: Float64Array | None, stamp_ns: int) -> bytes:
    """Return an arrow between two places (2, 3) of the proximity depth frame, or the removal of the last one."""
    kind, at, nothing = _type(MARKER), _type("geometry_msgs/msg/Point"), np.empty(0, np.uint8)
    pose = _type("geometry_msgs/msg/Pose")(at(0.0, 0.0, 0.0), _quaternion(np.eye(4)))
    return _message(
        MARKER,
        _header(ros.PROXIMITY_FRAME, stamp_ns),
        "force",
        0,
        kind.ARROW,
        kind.DELETE if ends_m is None else kind.ADD,
        pose,
        _type("geometry_msgs/msg/Vector3")(*_ARROW_M),
        _type("std_msgs/msg/ColorRGBA")(*_ARROW_RGBA),
        _type("builtin_interfaces/msg/Duration")(0, 0),
        False,
        [] if ends_m is None else [at(*place) for place in ends_m.tolist()],
        [],
        "",
        _type("sensor_msgs/msg/CompressedImage")(_header(ros.PROXIMITY_FRAME, stamp_ns), "", nothing),
        [],
        "",
        "",
        _type("visualization_msgs/msg/MeshFile")("", nothing),
        False,
    )


def topics_of(preset: Preset | None) -> dict[str, str]:
    """Return the types of the topics of a preset's patches."""
    has_force = preset is not None and preset.contact_test == "pressure"
    return PATCH_TOPICS | (FORCE_TOPICS if has_force else {})


def patch_builders(patch: ContactPatch, stamp_ns: int) -> dict[str, Callable[[], bytes | None]]:
    """Return by topic what builds each message of a patch, or None where the contact test or its preset has none."""

    def doubt() -> bytes:
        values = {
            "touch_probability": f"{patch.doubt.touch_probability:.4f}",
            "boundary_error_mm": f"{patch.doubt.boundary_error_mm:.3f}",  # nan where it is not known
            "doubt": ", ".join(patch.doubt.reasons),
        }
        return diagnostics("contact", values, stamp_ns)

    def of_newtons() -> bytes | None:
        place_m = patch.pressure_centre_m  # None: no contact, no force, no torque
        place_m = np.zeros(3) if place_m is None else place_m
        return None if patch.force_n is None else wrench(patch.force_n, place_m, stamp_ns)

    facts = patch.pressure
    return {
        Topic.PATCH: lambda: point_cloud(patch.points, stamp_ns, values={} if facts is None else facts.by_point()),
        Topic.AREA: lambda: number(patch.area_mm2),
        Topic.DOUBT: doubt,
        Topic.WRENCH: of_newtons,
        Topic.RELATIVE_FORCE: lambda: None if facts is None else vector(*facts.force_mm2, stamp_ns),
        Topic.FORCE_ARROW: lambda: None if facts is None else arrow(patch.force_arrow_m, stamp_ns),
    }


def patch_parts(patch: ContactPatch, stamp_ns: int) -> dict[str, bytes]:
    """Return the messages of a patch by topic."""
    found = {topic: build() for topic, build in patch_builders(patch, stamp_ns).items()}
    return {topic: data for topic, data in found.items() if data is not None}


def number(value: float) -> bytes:
    return _message(NUMBER, float(value))


def diagnostics(name: str, values: Mapping[str, str], stamp_ns: int) -> bytes:
    status, pair = _type("diagnostic_msgs/msg/DiagnosticStatus"), _type("diagnostic_msgs/msg/KeyValue")
    pairs = [pair(key, value) for key, value in values.items()]
    entry = status(level=status.OK, name=name, message="", hardware_id="", values=pairs)
    return _message(DIAGNOSTICS, _header("", stamp_ns), [entry])


def text(value: str) -> bytes:
    return _message(ros.TEXT, value)


def frame_text(frame: SensorFrame) -> bytes:
    """Return a frame's number and exact time stamps, serialised."""
    return text(json.dumps(frame.numbers(), allow_nan=False))


def point_cloud(
    points: Float32Array,
    stamp_ns: int,
    frame_id: str = ros.PROXIMITY_FRAME,
    values: Mapping[str, Float32Array] = MappingProxyType({}),
) -> bytes:
    """Return a cloud of points in metres: (N, 3), or (H, W, 3) with nan where a pixel has no point; values are (N,)."""
    height, width = points.shape[:2] if points.ndim == 3 else (1, len(points))
    names, is_dense = ("x", "y", "z", *values), points.ndim == 2
    points = np.column_stack([points, *values.values()]) if values else points
    field = _type("sensor_msgs/msg/PointField")
    frame = _message(  # it ends with the length of the data and is_dense
        ros.POINT_CLOUD,
        header=_header(frame_id, stamp_ns),
        height=height,
        width=width,
        fields=[field(name, 4 * i, field.FLOAT32, 1) for i, name in enumerate(names)],
        is_bigendian=False,
        point_step=4 * len(names),
        row_step=4 * len(names) * width,
        data=np.empty(0, np.uint8),
        is_dense=is_dense,
    )
    data = np.ascontiguousarray(points, "<f4").reshape(-1).view(np.uint8)
    return b"".join((frame[:-5], struct.pack("<I", data.size), data.data, frame[-1:]))


@dataclass(frozen=True)
class ImageStream:
    """One image topic, with what all its messages share: ``head`` up to the pixels, and ``lens``, its camera info."""

    topic: Topic
    of_tactile: bool
    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    head: bytes
    lens: bytes | None

    def check(self, image: AnyArray, sequence: int) -> None:
        """Raise `FrameError` if an image has another size or type than the stream."""
        if image.shape != self.shape or image.dtype != self.dtype:
            raise FrameError(
                f"frame {sequence}: the image for {self.topic} is {image.dtype}, {image.shape}, "
                f"but the rig needs {self.dtype}, {self.shape}; use the rig of the camera that took it"
            )

    def parts(self, image: AnyArray, sequence: int, stamp_ns: int) -> tuple[bytes, memoryview]:
        """Return an image message in two pieces, its pixels without a copy."""
        self.check(image, sequence)
        return stamped(self.head, stamp_ns), np.ascontiguousarray(image).reshape(-1).view(np.uint8).data


@lru_cache(maxsize=4)
def image_streams(rig: Rig) -> Mapping[Topic, ImageStream]:
    """Return the streams of a rig's frames, made once."""
    proximity, tactile = rig.proximity.intrinsics, rig.tactile.intrinsics
    color, color_frame = proximity, ros.PROXIMITY_FRAME
    if rig.proximity_color is not None:
        color, color_frame = rig.proximity_color.intrinsics, ros.PROXIMITY_COLOR_FRAME
    streams = (
        _stream(Topic.PROXIMITY_DEPTH, ros.PROXIMITY_FRAME, "16UC1", proximity),
        _stream(Topic.PROXIMITY_COLOR, color_frame, "rgb8", color),
        _stream(Topic.TACTILE_DEPTH, ros.TACTILE_FRAME, "16UC1", tactile, of_tactile=True),
        _stream(Topic.TACTILE_COLOR, ros.TACTILE_FRAME, "rgb8", tactile, of_tactile=True),
        _stream(Topic.TRUTH_CONTACT, ros.PROXIMITY_FRAME, "mono8", proximity, with_lens=False),
        _stream(Topic.TRUTH_DEPTH, ros.PROXIMITY_FRAME, "32FC1", proximity, with_lens=False),
    )
    return {stream.topic: stream for stream in streams if rig.has_proximity or "proximity" not in stream.topic}


def images_of(frame: SensorFrame, rig: Rig) -> Iterator[tuple[Topic, AnyArray]]:
    for name, image in frame.images(rig).items():
        yield Topic[name.removesuffix("_m").upper()], image * np.uint8(255) if image.dtype == np.bool_ else image


def _quaternion(pose: Float64Array) -> Any:
    from scipy.spatial.transform import Rotation  # slow to import

    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
    return _type("geometry_msgs/msg/Quaternion")(x, y, z, w)


def _header(frame_id: str, stamp_ns: int = 0) -> Any:
    return _type("std_msgs/msg/Header")(_type("builtin_interfaces/msg/Time")(*divmod(stamp_ns, 10**9)), frame_id)


def _message(kind: str, *fields: Any, **named: Any) -> bytes:
    """Return a whole message, serialised."""
    return bytes(ros.TYPES.serialize_cdr(_type(kind)(*fields, **named), kind))


def _type(name: str) -> Any:
    return ros.TYPES.types[name]


def _stream(
    topic: Topic, frame_id: str, encoding: str, lens: Intrinsics, *, of_tactile: bool = False, with_lens: bool = True
) -> ImageStream:
    dtype, channels = _PIXELS[encoding]
    row_bytes = lens.width * dtype.itemsize * channels
    empty = _message(ros.IMAGE, _header(frame_id), *lens.shape, encoding, 0, row_bytes, np.empty(0, np.uint8))
    head = empty[:-4] + struct.pack("<I", lens.height * row_bytes)  # up to the pixels, which follow unchanged
    shape = lens.shape if channels == 1 else (*lens.shape, channels)
    return ImageStream(topic, of_tactile, shape, dtype, head, camera_info(frame_id, lens) if with_lens else None)
