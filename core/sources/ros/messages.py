"""ROS 2 messages of recordings and live connections: topics, types, frames, and reading them from bytes (CDR).

`tactune.core.output.messages` builds them.

The guide lists the topics of a recording (``docs/guide/recording.md``). Depth is stored in the cameras' raw counts.
The rig contains their units. It is attached as ``rig.json``, and a message for tools that copy no attachments.

A lens model that ROS does not know (librealsense's inverse and modified Brown-Conrady) is written as
``plumb_bob`` with the same coefficients, as the camera maker's own ROS driver does.
"""

from __future__ import annotations

import shutil
import struct
import sys
from abc import ABC, abstractmethod
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ...model.arrays import Float64Array, Int64Array
from ...model.frames import pose_matrix
from ..base import Progress
from ..ros_image import DamagedFileError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

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


class Topic(StrEnum):
    """Topics of recordings and live connections."""

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
    AREA = "/contact/area_mm2"
    DOUBT = "/contact/doubt"
    FINDINGS = "/contact/findings"
    WRENCH = "/contact/wrench"
    RELATIVE_FORCE = "/contact/relative_force_mm2"
    FORCE_ARROW = "/contact/force_arrow"
    TILT = "/contact/tilt"
    TILT_SIGMA = "/contact/tilt_sigma"
    PROXIMITY_CLOUD = "/proximity/points"
    TACTILE_CLOUD = "/tactile/points"
    OBJECT_POSE = "/object/pose"
    TRANSFORMS = "/tf"
    DIAGNOSTICS = "/diagnostics"

    @property
    def camera_info(self) -> str:
        """The topic of the lens of an image topic."""
        return self.removesuffix("image") + "camera_info"


PROXIMITY_FRAME: Final = "proximity_depth_optical_frame"
PROXIMITY_COLOR_FRAME: Final = "proximity_color_optical_frame"
TACTILE_FRAME: Final = "tactile_depth_optical_frame"
#: Frame of the known object.
OBJECT_FRAME: Final = "object"


def matrix_of(transform: Any) -> Float64Array:
    """Return the 4 x 4 matrix of a ROS transform, its quaternion normalised; of one that is no rotation, nan."""
    from scipy.spatial.transform import Rotation  # slow to import

    q, t = transform.rotation, transform.translation
    quaternion = np.array((q.x, q.y, q.z, q.w))
    if not quaternion @ quaternion > 0:  # also nan
        return np.full((4, 4), np.nan)
    return pose_matrix(Rotation.from_quat(quaternion).as_matrix(), (t.x, t.y, t.z))


#: What ``ros2 bag record --compression-mode`` writes begins so: a message in any container, or a whole file.
ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"


def unpacked(data: memoryview) -> memoryview:
    """Return the bytes of a message, decompressed if they are compressed."""
    if bytes(data[:4]) != ZSTD_MAGIC:
        return data
    try:
        return memoryview(zstd.decompress(data))
    except zstd.ZstdError as error:
        raise DamagedFileError(f"a message cannot be unpacked ({error})") from error


def unpack_file(path: Path, target: Path) -> None:
    """Decompress a file as a whole."""
    with zstd.open(path, "rb") as packed, target.open("wb") as plain:
        shutil.copyfileobj(packed, plain)


#: Message types of poses. The library knows those of ROS 2 only.
POSES: Final = (TRANSFORMS, "tf/msg/tfMessage")


class Bag(ABC):
    """Messages of a recording, and their type by topic; not ``complete`` if its recorder was killed."""

    complete = True

    def __init__(self) -> None:
        self.types: dict[str, str] = {}

    @abstractmethod
    def count(self, topic: str) -> int:
        """Return the number of messages of a topic; 0 without the topic."""

    @abstractmethod
    def raw(self, topic: str, index: int) -> memoryview:
        """Return the bytes of a message, by its number in the order of the recorder's clock."""

    @abstractmethod
    def times_ns(self, topic: str) -> Int64Array:
        """Return when each message of a topic was recorded."""

    @abstractmethod
    def close(self) -> None:
        """Close the file; twice is harmless."""

    def is_ros1(self, topic: str) -> bool:
        """Whether the bytes of a topic's messages are ROS 1's, not CDR."""
        return False

    def message(self, topic: str, index: int) -> Any:
        data, kind = self.raw(topic, index), self.types[topic]
        if self.is_ros1(topic):
            return _ros1().deserialize_ros1(bytes(data), kind)
        return TYPES.deserialize_cdr(data, kind)

    def stamp_ns(self, topic: str, index: int) -> int:
        """Return the stamp in the header with which a message begins; no image is unpacked for it."""
        return stamp_ns(self.raw(topic, index), is_ros1=self.is_ros1(topic))

    def stamps_s(self, topic: str, progress: Progress | None = None) -> Float64Array:
        """Return the stamp of each message of a topic, seconds."""
        stamps_ns: Int64Array = np.empty(self.count(topic), np.int64)
        for index in range(len(stamps_ns)):
            if progress is not None and index % 100 == 0:
                progress(index / len(stamps_ns), f"reading the time stamps of {topic}")
            stamps_ns[index] = self.stamp_ns(topic, index)
        return np.asarray(stamps_ns * 1e-9, np.float64)


def stamp_ns(data: bytes | memoryview, *, is_ros1: bool = False) -> int:
    """Return the stamp in the header with which a message begins."""
    order = "<" if is_ros1 or data[1] & 1 else ">"  # the second byte of CDR
    seconds, nanoseconds = struct.unpack_from(order + "II", data, 4)  # both put four bytes in front
    return int(seconds) * 10**9 + int(nanoseconds)


@cache
def _ros1() -> Any:
    types = get_typestore(Stores.ROS1_NOETIC)
    for name in POSES:
        types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
    return types


def long_name(kind: str) -> str:
    """Return a message type as ROS 2 writes it: ``sensor_msgs/msg/Image``."""
    package, _, name = kind.partition("/")
    return kind if name.startswith("msg/") else f"{package}/msg/{name}"
