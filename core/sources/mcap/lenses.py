"""The rig of a bag that was not recorded by us: lenses and poses as ROS tells them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from ...errors import SourceError
from ...model.frames import ColorCamera, DepthCamera, Matrix4, Rig, rigid_transform
from ...model.intrinsics import Distortion, Intrinsics
from .messages import CAMERA_INFO, TRANSFORMS, Topic, matrix_of, parse
from .reader import McapFile

#: What ROS takes 16UC1 for.
_ROS_UNIT_M = 0.001


def rig_from_lenses(file: McapFile) -> Rig:
    """Make a rig of camera infos and static transforms; depth counts as millimetres.

    The colour camera is left out where there is no pose for it: colour then counts as aligned to depth.

    Raises
    ------
    SourceError
        A camera info is missing or has a lens that is not known.
    """
    proximity, tactile = (_camera_info(file, topic) for topic in (Topic.PROXIMITY_DEPTH, Topic.TACTILE_DEPTH))
    color = None
    if Topic.PROXIMITY_COLOR.camera_info in file.topics:
        info = _camera_info(file, Topic.PROXIMITY_COLOR)
        pose = _pose(file, info.header.frame_id, proximity.header.frame_id)
        color = None if pose is None else ColorCamera(intrinsics=_lens(info, file.path), T_color_depth=pose)
    return Rig(
        proximity=DepthCamera(intrinsics=_lens(proximity, file.path), depth_unit_m=_ROS_UNIT_M),
        tactile=DepthCamera(intrinsics=_lens(tactile, file.path), depth_unit_m=_ROS_UNIT_M),
        proximity_color=color,
        T_proximity_tactile=_pose(file, proximity.header.frame_id, tactile.header.frame_id),
    )


def _camera_info(file: McapFile, topic: Topic) -> Any:
    places = file.places(topic.camera_info)
    if not len(places):
        raise SourceError(f"{file.path} has no {topic.camera_info} and no rig; record the lenses, too")
    return parse(file.message(places[0]), CAMERA_INFO, file.path)


def _lens(info: Any, origin: Path) -> Intrinsics:
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


def _pose(file: McapFile, first: str, second: str) -> Matrix4 | None:
    """Return the transform that takes coordinates in the second frame to the first, if a message tells it."""
    for place in file.places(Topic.STATIC_TRANSFORMS):
        for transform in parse(file.message(place), TRANSFORMS, file.path).transforms:
            frames = transform.header.frame_id, transform.child_frame_id
            if set(frames) != {first, second}:
                continue
            try:
                pose = matrix_of(transform.transform)
                return pose if frames == (first, second) else rigid_transform(np.linalg.inv(np.array(pose)))
            except ValueError as error:
                raise SourceError(f"{file.path}: the pose of {second} in {first}: {error}; record it again") from error
    return None
