"""ROS 2 messages of a recording: topics, frames, definitions and their bytes (CDR).

A recording holds, for every frame of the sensor:

=================================== ========================== ==================================
topic                               type                       contents
=================================== ========================== ==================================
``/proximity/depth/image``          ``sensor_msgs/Image``      16UC1, raw counts
``/proximity/color/image``          ``sensor_msgs/Image``      rgb8
``/tactile/depth/image``            ``sensor_msgs/Image``      16UC1, raw counts
``/tactile/color/image``            ``sensor_msgs/Image``      rgb8, aligned to depth  (where known)
``…/camera_info``                   ``sensor_msgs/CameraInfo`` beside each of these images
``/truth/contact/image``            ``sensor_msgs/Image``      mono8, 0 or 255         (where known)
``/truth/depth/image``              ``sensor_msgs/Image``      32FC1, metres           (where known)
``/tactune/frame``                  ``std_msgs/String``        JSON: the sequence number and both
                                                               time stamps, every bit
``/tactune/rig``                    ``std_msgs/String``        JSON: the rig, once
``/tf_static``                      ``tf2_msgs/TFMessage``     factory poses, once
=================================== ========================== ==================================

Depth is stored in the cameras' raw counts, so playback is bit-identical. ROS reads 16UC1 as
millimetres: clouds that Foxglove or RViz make of it are too large by a factor of 4 for an L515
(0.25 mm) and 10 for a D405 (0.1 mm). The rig contains the units. It is also attached as
``rig.json``; the topic is for tools that copy messages without attachments.

A lens model that ROS does not know (librealsense's inverse and modified Brown-Conrady) is written as
``plumb_bob`` with the same coefficients, as the camera maker's own ROS driver does.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from ...errors import FrameError, SourceError
from ...model.arrays import AnyArray, Float32Array, Float64Array
from ...model.frames import Matrix4, Rig, SensorFrame, rigid_transform
from ...model.intrinsics import Intrinsics

#: Names of the metadata record and the attachments inside a recording.
METADATA_NAME: Final = "tactune"
RIG_NAME: Final = "rig.json"
PRESET_NAME: Final = "preset.json"
#: The untouched frame. The name is part of the format: recordings made before the present word have it too.
UNTOUCHED_NAME: Final = "reference.npz"

#: Version of the recording format. It grows when an older reader cannot read a newer recording.
FORMAT_VERSION: Final = 1

TYPES: Final = get_typestore(Stores.ROS2_HUMBLE)

IMAGE: Final = "sensor_msgs/msg/Image"
CAMERA_INFO: Final = "sensor_msgs/msg/CameraInfo"
POINT_CLOUD: Final = "sensor_msgs/msg/PointCloud2"
TEXT: Final = "std_msgs/msg/String"
TRANSFORMS: Final = "tf2_msgs/msg/TFMessage"

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


class Topic(StrEnum):
    """Topics of a recording."""

    FRAME = "/tactune/frame"
    RIG = "/tactune/rig"
    STATIC_TRANSFORMS = "/tf_static"
    PROXIMITY_DEPTH = "/proximity/depth/image"
    PROXIMITY_COLOR = "/proximity/color/image"
    TACTILE_DEPTH = "/tactile/depth/image"
    TACTILE_COLOR = "/tactile/color/image"
    TRUTH_CONTACT = "/truth/contact/image"
    TRUTH_DEPTH = "/truth/depth/image"
    PATCH = "/contact/patch"

    @property
    def camera_info(self) -> str:
        """The topic of the lens of an image topic."""
        return self.removesuffix("image") + "camera_info"


#: Topics with one message, which players keep for late subscribers.
SAID_ONCE: Final = (Topic.RIG, Topic.STATIC_TRANSFORMS)

PROXIMITY_FRAME: Final = "proximity_depth_optical_frame"
PROXIMITY_COLOR_FRAME: Final = "proximity_color_optical_frame"
TACTILE_FRAME: Final = "tactile_depth_optical_frame"

_LAST_STAMP_NS = (2**31) * 10**9 - 1
_DTYPES: dict[str, np.dtype[Any]] = {
    "16UC1": np.dtype("<u2"),
    "rgb8": np.dtype("u1"),
    "mono8": np.dtype("u1"),
    "32FC1": np.dtype("<f4"),
}
_CHANNELS = {"rgb8": 3}


def nanoseconds(time_s: float) -> int:
    """Return a time in whole nanoseconds, within what a ROS time stamp can hold."""
    return min(max(round(time_s * 1e9), -(2**31) * 10**9), _LAST_STAMP_NS)


class LogClock:
    """Log times that follow the time stamps and always increase, even where the stamps do not.

    Players sort by log time, so a camera's clock that jumps back must not reorder the frames.
    """

    def __init__(self, period_s: float) -> None:
        self._period_ns = max(nanoseconds(period_s), 1)
        self._shift_ns = 0
        self._last_ns: int | None = None

    def tick(self, stamp_ns: int) -> int:
        """Return the log time of a frame with this stamp, nanoseconds from 0."""
        earliest_ns = 0 if self._last_ns is None else self._last_ns + 1
        if stamp_ns + self._shift_ns < earliest_ns:
            resume_ns = 0 if self._last_ns is None else self._last_ns + self._period_ns
            self._shift_ns = resume_ns - stamp_ns
        self._last_ns = stamp_ns + self._shift_ns
        return self._last_ns


def definition(message_type: str) -> str:
    """Return the definition of a message type and of the types inside it."""
    return TYPES.generate_msgdef(message_type, ros_version=2)[0]


def type_hash(message_type: str) -> str:
    """Return the hash by which ROS 2 identifies this definition."""
    return TYPES.hash_rihs01(message_type)


def stamped(template: bytes, stamp_ns: int) -> bytes:
    """Return a serialised message, whose first field is a header, with another time stamp."""
    seconds, rest = divmod(stamp_ns, 10**9)
    return template[:4] + struct.pack("<iI", seconds, rest) + template[12:]


def image_head(frame_id: str, encoding: str, shape: tuple[int, int], pixel_bytes: int) -> bytes:
    """Return a serialised image up to its pixels, which follow unchanged."""
    height, width = shape
    row_bytes = width * pixel_bytes
    empty = _type(IMAGE)(_header(frame_id), height, width, encoding, 0, row_bytes, np.empty(0, np.uint8))
    return _serialise(empty, IMAGE)[:-4] + struct.pack("<I", height * row_bytes)


def camera_info(frame_id: str, lens: Intrinsics) -> bytes:
    """Return a serialised lens."""
    k = lens.camera_matrix()
    region = _type("sensor_msgs/msg/RegionOfInterest")(0, 0, 0, 0, False)
    message = _type(CAMERA_INFO)(
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
        roi=region,
    )
    return _serialise(message, CAMERA_INFO)


def static_transforms(rig: Rig, stamp_ns: int) -> bytes:
    """Return the factory poses that the rig knows, serialised, in the proximity depth frame."""
    poses: list[tuple[str, Float64Array]] = []
    if rig.T_proximity_tactile is not None:
        poses.append((TACTILE_FRAME, np.array(rig.T_proximity_tactile)))
    if rig.proximity_color is not None:
        T_depth_color = np.linalg.inv(np.array(rig.proximity_color.T_color_depth)).astype(np.float64)
        poses.append((PROXIMITY_COLOR_FRAME, T_depth_color))
    seconds, rest = divmod(stamp_ns, 10**9)
    header = _header(PROXIMITY_FRAME, seconds, rest)
    stamped_pose = _type("geometry_msgs/msg/TransformStamped")
    return _serialise(
        _type(TRANSFORMS)([stamped_pose(header, child, _transform(pose)) for child, pose in poses]), TRANSFORMS
    )


def text(value: str) -> bytes:
    """Return a text, serialised."""
    return _serialise(_type(TEXT)(value), TEXT)


def frame_text(frame: SensorFrame) -> bytes:
    """Return a frame's number and exact time stamps, serialised."""
    values = {
        "sequence": int(frame.sequence),
        "proximity_time_s": float(frame.proximity_time_s),
        "tactile_time_s": float(frame.tactile_time_s),
    }
    return text(json.dumps(values, allow_nan=False))


def point_cloud(points: Float32Array, stamp_ns: int) -> bytes:
    """Return points (N, 3) in the proximity depth frame, metres, serialised."""
    field = _type("sensor_msgs/msg/PointField")
    seconds, rest = divmod(stamp_ns, 10**9)
    message = _type(POINT_CLOUD)(
        header=_header(PROXIMITY_FRAME, seconds, rest),
        height=1,
        width=len(points),
        fields=[field(name, 4 * i, field.FLOAT32, 1) for i, name in enumerate("xyz")],
        is_bigendian=False,
        point_step=12,
        row_step=12 * len(points),
        data=np.ascontiguousarray(points, "<f4").view(np.uint8).ravel(),
        is_dense=True,
    )
    return _serialise(message, POINT_CLOUD)


@dataclass(frozen=True)
class ImageStream:
    """One image topic, with the parts that all its messages share, serialised once.

    Attributes
    ----------
    head : bytes
        An image message up to its pixels, without a time stamp.
    lens : bytes or None
        The camera info that goes with each image.
    """

    topic: Topic
    of_tactile: bool
    shape: tuple[int, int]
    dtype: np.dtype[Any]
    channels: int
    head: bytes
    lens: bytes | None

    def check(self, image: AnyArray, sequence: int) -> None:
        """Raise `FrameError` if an image has another size or type than the stream."""
        shape = self.shape if self.channels == 1 else (*self.shape, self.channels)
        if image.shape != shape or image.dtype != self.dtype:
            raise FrameError(
                f"frame {sequence}: the image for {self.topic} is {image.dtype}, {image.shape}, "
                f"but the rig needs {self.dtype}, {shape}; use the rig of the camera that took it"
            )


def image_streams(rig: Rig) -> dict[Topic, ImageStream]:
    """Return the streams of a rig's frames."""
    proximity, tactile = rig.proximity.intrinsics, rig.tactile.intrinsics
    color, color_frame = proximity, PROXIMITY_FRAME
    if rig.proximity_color is not None:
        color, color_frame = rig.proximity_color.intrinsics, PROXIMITY_COLOR_FRAME
    streams = (
        _stream(Topic.PROXIMITY_DEPTH, PROXIMITY_FRAME, "16UC1", proximity),
        _stream(Topic.PROXIMITY_COLOR, color_frame, "rgb8", color),
        _stream(Topic.TACTILE_DEPTH, TACTILE_FRAME, "16UC1", tactile, of_tactile=True),
        _stream(Topic.TACTILE_COLOR, TACTILE_FRAME, "rgb8", tactile, of_tactile=True),
        _stream(Topic.TRUTH_CONTACT, PROXIMITY_FRAME, "mono8", proximity, with_lens=False),
        _stream(Topic.TRUTH_DEPTH, PROXIMITY_FRAME, "32FC1", proximity, with_lens=False),
    )
    return {stream.topic: stream for stream in streams}


def images_of(frame: SensorFrame) -> Iterator[tuple[Topic, AnyArray]]:
    """Yield the images of a frame with their topics."""
    yield Topic.PROXIMITY_DEPTH, frame.proximity_depth
    yield Topic.PROXIMITY_COLOR, frame.proximity_color
    yield Topic.TACTILE_DEPTH, frame.tactile_depth
    if frame.tactile_color is not None:
        yield Topic.TACTILE_COLOR, frame.tactile_color
    if frame.truth is not None:
        yield Topic.TRUTH_CONTACT, np.where(frame.truth.contact, np.uint8(255), np.uint8(0))
        if frame.truth.depth_m is not None:
            yield Topic.TRUTH_DEPTH, frame.truth.depth_m


def parse(data: memoryview, message_type: str, origin: Path) -> Any:
    """Return a message from its bytes; `SourceError` names the file, ``origin``, if they are damaged."""
    try:
        return TYPES.deserialize_cdr(data, message_type)
    except Exception as error:  # the library checks with whatever Python raises
        raise SourceError(f"{origin} has a message that is no {message_type}; record it again") from error


def matrix_of(transform: Any) -> Matrix4:
    """Return the 4 x 4 matrix of a ROS transform; `ValueError` if it is not rigid."""
    q, t = transform.rotation, transform.translation
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    matrix[:3, 3] = t.x, t.y, t.z
    return rigid_transform(matrix)


def _transform(pose: Float64Array) -> Any:
    vector, quaternion = _type("geometry_msgs/msg/Vector3"), _type("geometry_msgs/msg/Quaternion")
    rotation = Rotation.from_matrix(pose[:3, :3]).as_quat()
    return _type("geometry_msgs/msg/Transform")(vector(*map(float, pose[:3, 3])), quaternion(*map(float, rotation)))


def _header(frame_id: str, seconds: int = 0, nanoseconds: int = 0) -> Any:
    return _type("std_msgs/msg/Header")(_type("builtin_interfaces/msg/Time")(seconds, nanoseconds), frame_id)


def _serialise(message: Any, message_type: str) -> bytes:
    return bytes(TYPES.serialize_cdr(message, message_type))


def _type(name: str) -> Any:
    return TYPES.types[name]


def _stream(
    topic: Topic, frame_id: str, encoding: str, lens: Intrinsics, *, of_tactile: bool = False, with_lens: bool = True
) -> ImageStream:
    dtype, channels = _DTYPES[encoding], _CHANNELS.get(encoding, 1)
    return ImageStream(
        topic=topic,
        of_tactile=of_tactile,
        shape=lens.shape,
        dtype=dtype,
        channels=channels,
        head=image_head(frame_id, encoding, lens.shape, dtype.itemsize * channels),
        lens=camera_info(frame_id, lens) if with_lens else None,
    )
