"""Calibrations as files of other tools: a ROS 2 launch file of static transforms, Kalibr's camchain, URDF."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.sax.saxutils import quoteattr

import numpy as np

from ..contact.alignment import tactile_pose
from ..errors import ExportError
from ..model.arrays import Float64Array
from ..model.files import atomic_path
from ..model.frames import Rig
from ..model.intrinsics import Distortion, Intrinsics
from ..preset import Preset
from ..sources.ros.messages import PROXIMITY_COLOR_FRAME, PROXIMITY_FRAME, TACTILE_FRAME


@dataclass(frozen=True, eq=False)
class _Camera:
    """A camera by its optical frame; ``pose`` is ``T_proximity_camera``."""

    frame: str
    topic: str
    lens: Intrinsics
    pose: Float64Array


def export_calibration(
    path: Path, kind: str, rig: Rig, preset: Preset | None = None, *, exclusive: bool = False
) -> None:
    """Write lenses and poses of a rig as "ros", "kalibr" or "urdf"; a preset's pose replaces the rig's."""
    cameras = list(_cameras(rig, preset))
    text = _WRITERS[kind](cameras)
    with atomic_path(path, exclusive=exclusive) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _cameras(rig: Rig, preset: Preset | None) -> Iterator[_Camera]:
    if not rig.has_proximity:
        yield _Camera(TACTILE_FRAME, "/tactile/depth/image", rig.tactile.intrinsics, np.eye(4))
        return
    yield _Camera(PROXIMITY_FRAME, "/proximity/depth/image", rig.proximity.intrinsics, np.eye(4))
    alignment = Preset().alignment if preset is None else preset.alignment
    if alignment.model == "homography":
        raise ExportError("the preset's alignment is a homography, not a pose; calibrate the rigid model")
    yield _Camera(TACTILE_FRAME, "/tactile/depth/image", rig.tactile.intrinsics, tactile_pose(alignment, rig))
    if rig.proximity_color is not None:
        color = np.linalg.inv(np.array(rig.proximity_color.T_color_depth))
        yield _Camera(PROXIMITY_COLOR_FRAME, "/proximity/color/image", rig.proximity_color.intrinsics, color)


def _number(value: float) -> str:
    """Return a decimal number; parsers of YAML 1.1 take 1e-05 for a text."""
    return f"{value:.12f}"


def _numbers(values: Float64Array) -> str:
    return ", ".join(map(_number, np.ravel(values).tolist()))


def _launch(cameras: list[_Camera]) -> str:
    from scipy.spatial.transform import Rotation  # slow to import

    if len(cameras) == 1:
        raise ExportError("the rig has one camera, so there is no transform to publish; export its lens to Kalibr")
    nodes = []
    for camera in cameras[1:]:
        x, y, z = camera.pose[:3, 3]
        turn = Rotation.from_matrix(camera.pose[:3, :3]).as_quat()
        names = ("--x", "--y", "--z", "--qx", "--qy", "--qz", "--qw")
        places = " ".join(f"{name} {_number(value)}" for name, value in zip(names, (x, y, z, *turn), strict=True))
        nodes.append(
            f"- node:\n    pkg: tf2_ros\n    exec: static_transform_publisher\n    name: {camera.frame}_publisher\n"
            f'    args: "{places} --frame-id {PROXIMITY_FRAME} --child-frame-id {camera.frame}"\n'
        )
    return "# ros2 launch FILE: static transforms of the optical frames, metres and quaternions\nlaunch:\n" + "".join(
        nodes
    )


def _camchain(cameras: list[_Camera]) -> str:
    text = ""
    for index, camera in enumerate(cameras):
        lens = camera.lens
        focal = np.array([lens.fx, lens.fy, lens.cx, lens.cy])
        text += f"cam{index}:\n"
        if index:
            rows = (f"  - [{_numbers(row)}]\n" for row in np.linalg.inv(camera.pose) @ cameras[index - 1].pose)
            text += "  T_cn_cnm1:\n" + "".join(rows)
        text += (
            "  camera_model: pinhole\n"
            f"  intrinsics: [{_numbers(focal)}]\n"
            f"  distortion_model: {'radtan' if lens.has_distortion else 'none'}\n"
            f"  distortion_coeffs: [{_numbers(_radtan(lens, camera.frame))}]\n"
            f"  resolution: [{lens.width}, {lens.height}]\n"
            f"  rostopic: {camera.topic}\n"
        )
    return text


def _radtan(lens: Intrinsics, frame: str) -> Float64Array:
    if not lens.has_distortion:
        return np.empty(0)
    if lens.distortion is not Distortion.BROWN_CONRADY or lens.coefficients[4]:
        raise ExportError(
            f"the lens of {frame} is {lens.distortion} with k3 = {lens.coefficients[4]:g}, but Kalibr's radtan is "
            "brown_conrady without k3; export to URDF or ROS, which state no lens"
        )
    return np.array(lens.coefficients[:4])


def _urdf(cameras: list[_Camera]) -> str:
    from scipy.spatial.transform import Rotation  # slow to import

    lines = ['<?xml version="1.0"?>', '<robot name="tactune_rig">']
    lines += [f"  <link name={quoteattr(camera.frame)}/>" for camera in cameras]
    for camera in cameras[1:]:
        with warnings.catch_warnings():  # at a pitch of 90 degrees roll is chosen as 0, which is as right as another
            warnings.simplefilter("ignore")
            rpy = Rotation.from_matrix(camera.pose[:3, :3]).as_euler("xyz")
        xyz, turn = (" ".join(map(_number, values.tolist())) for values in (camera.pose[:3, 3], rpy))
        lines += [
            f'  <joint name={quoteattr(camera.frame + "_joint")} type="fixed">',
            f"    <parent link={quoteattr(PROXIMITY_FRAME)}/>",
            f"    <child link={quoteattr(camera.frame)}/>",
            f'    <origin xyz="{xyz}" rpy="{turn}"/>',
            "  </joint>",
        ]
    return "\n".join([*lines, "</robot>", ""])


_WRITERS: Final[dict[str, Callable[[list[_Camera]], str]]] = {"ros": _launch, "kalibr": _camchain, "urdf": _urdf}
