"""ROS 2 messages of recordings and live connections: topics, types, frames, and reading them from bytes (CDR).

`tactune.core.output.messages` builds them.

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

from enum import StrEnum
from pathlib import Path
from typing import Any, Final

import numpy as np
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from ...errors import SourceError
from ...model.frames import Matrix4, camera_pose

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


def parse(data: bytes | memoryview, message_type: str, origin: Path) -> Any:
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
    return camera_pose(matrix)
