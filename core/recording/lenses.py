"""The rig of a bag that was not recorded by us: lenses and poses as ROS tells them."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..errors import SourceError
from ..frames import ColorCamera, DepthCamera, Rig, rigid_transform
from ..intrinsics import Distortion, Intrinsics
from .messages import CAMERA_INFO, TRANSFORMS, Topic, matrix_of, parse
from .reader import McapFile

#: What ROS takes 16UC1 for.
_ROS_UNIT_M = 0.001


def rig_from_lenses(file: McapFile, origin: str) -> Rig:
    """Make a rig of camera infos and static transforms; depth counts as millimetres.

    The colour camera is left out where there is no pose for it: colour then counts as aligned to depth.

    Raises
    ------
    SourceError
        A camera info is missing or has a lens that is not known.
    """
    proximity, tactile = (_camera_info(file, topic, origin) for topic in (Topic.PROXIMITY_DEPTH, Topic.TACTILE_DEPTH))
    poses = _poses(file)
    color = None
    if Topic.PROXIMITY_COLOR.camera_info in file.topics:
        info = _camera_info(file, Topic.PROXIMITY_COLOR, origin)
        pose = poses.get((info.header.frame_id, proximity.header.frame_id))
        color = pose and ColorCamera(intrinsics=_lens(info, origin), T_color_depth=pose)
    return Rig(
        proximity=DepthCamera(intrinsics=_lens(proximity, origin), depth_unit_m=_ROS_UNIT_M),
        tactile=DepthCamera(intrinsics=_lens(tactile, origin), depth_unit_m=_ROS_UNIT_M),
        proximity_color=color,
        T_proximity_tactile=poses.get((proximity.header.frame_id, tactile.header.frame_id)),
    )


def _camera_info(file: McapFile, topic: Topic, origin: str) -> Any:
    places = file.places(topic.camera_info)
    if not len(places):
        raise SourceError(f"{origin} has no {topic.camera_info} and no rig; record the lenses, too")
    return parse(file.message(places[0]), CAMERA_INFO)


def _lens(info: Any, origin: str) -> Intrinsics:
    if info.distortion_model not in ("", "plumb_bob") or len(info.d) > 5:
        raise SourceError(f"{origin} has the lens model {info.distortion_model!r}; only plumb_bob is known")
    coefficients = [*map(float, info.d), *[0.0] * (5 - len(info.d))]
    try:
        return Intrinsics(
            width=info.width,
            height=info.height,
            fx=info.k[0],
            fy=info.k[4],
            cx=info.k[2],
            cy=info.k[5],
            distortion=Distortion.BROWN_CONRADY if any(coefficients) else Distortion.NONE,
            coefficients=tuple(coefficients),
        )
    except ValueError as error:
        raise SourceError(f"{origin} has a camera info with values out of range; record it again") from error


def _poses(file: McapFile) -> dict[tuple[str, str], Any]:
    """Return for two frames, a and b, the transform that takes coordinates in b to coordinates in a."""
    poses: dict[tuple[str, str], Any] = {}
    for place in file.places(Topic.STATIC_TRANSFORMS):
        for transform in parse(file.message(place), TRANSFORMS).transforms:
            pose = matrix_of(transform.transform)
            poses[transform.header.frame_id, transform.child_frame_id] = rigid_transform(pose)
            poses[transform.child_frame_id, transform.header.frame_id] = rigid_transform(np.linalg.inv(pose))
    return poses
