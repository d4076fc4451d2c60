"""What a device says of its streams: lens, pose, depth unit, and the modes that are wanted of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import ValidationError

from ...contact.masking import colors_at
from ...errors import SourceError
from ...model.arrays import Uint8Array, Uint16Array
from ...model.clouds import deproject, valid_depth
from ...model.frames import ColorCamera, DepthCamera, Matrix4, Rig, rigid_transform
from ...model.intrinsics import Distortion, Intrinsics
from .devices import DeviceInfo

WIDTH, HEIGHT, RATE_HZ = 640, 480, 30
_FORMATS = {"depth": "z16", "color": "rgb8"}
_NO_DISTORTION = {"distortion": Distortion.NONE}


@dataclass(frozen=True)
class Stream:
    """One stream of a device as it is opened: the driver's sensor and profile."""

    sensor: Any
    profile: Any


@dataclass(frozen=True)
class Calibration:
    """One camera as it describes itself.

    Attributes
    ----------
    T_color_depth : 4 x 4
        Takes points in the depth frame to the colour frame, metres.
    """

    depth: DepthCamera
    color: Intrinsics
    T_color_depth: Matrix4

    @property
    def color_is_aligned(self) -> bool:
        """Whether colour and depth pixels are the same rays."""
        lenses = [lens if lens.has_distortion else lens.model_copy(update=_NO_DISTORTION) for lens in self._lenses]
        return lenses[0] == lenses[1] and np.allclose(self.T_color_depth, np.eye(4), atol=1e-9)

    @property
    def _lenses(self) -> tuple[Intrinsics, Intrinsics]:
        return self.depth.intrinsics, self.color

    @property
    def color_camera(self) -> ColorCamera | None:
        """The colour camera as a rig states it."""
        if self.color_is_aligned:
            return None
        return ColorCamera(intrinsics=self.color, T_color_depth=self.T_color_depth)

    def color_on_depth(self, color: Uint8Array, depth: Uint16Array) -> Uint8Array:
        """Bring a colour image to the depth image's pixels; black where there is no depth or no colour."""
        if self.color_is_aligned:
            return color
        pixels = np.flatnonzero(valid_depth(depth))
        rig = Rig(proximity=self.depth, tactile=self.depth, proximity_color=self.color_camera)
        aligned = np.zeros((*depth.shape, 3), np.uint8)
        points = deproject(depth, self.depth, pixels)
        aligned.reshape(-1, 3)[pixels], _ = colors_at(points, pixels, color, rig)
        return aligned


def find_streams(device: Any, info: DeviceInfo) -> dict[str, Stream]:
    """Find the wanted mode of depth and colour among those that the sensors offer.

    Raises
    ------
    SourceError
        One is missing; the message names those that are there.
    """
    found: dict[str, Stream] = {}
    for sensor in device.query_sensors():
        for profile in sensor.get_stream_profiles():
            kind = profile.stream_type().name
            if kind not in found and _is_wanted(profile, kind):
                found[kind] = Stream(sensor, profile)
    for kind, form in _FORMATS.items():
        if kind not in found:
            there = [str(mode) for mode in info.modes if mode.stream == kind]
            raise SourceError(
                f"the {info.title} offers no {kind} stream of {WIDTH} x {HEIGHT} at {RATE_HZ} Hz ({form}), but "
                f"{', '.join(there[:12]) or 'none at all'}; use a USB 3 port, or update the camera's firmware"
            )
    return found


def _is_wanted(profile: Any, kind: str) -> bool:
    if not profile.is_video_stream_profile() or profile.format().name != _FORMATS.get(kind):
        return False
    video = profile.as_video_stream_profile()
    return (video.width(), video.height(), profile.fps()) == (WIDTH, HEIGHT, RATE_HZ)


def read_calibration(streams: dict[str, Stream], info: DeviceInfo) -> Calibration:
    """Ask the device for its lenses, the pose between them and the length of one raw count.

    Raises
    ------
    SourceError
        It reports something that cannot be.
    """
    depth, color = streams["depth"], streams["color"]
    unit_m = float(depth.sensor.as_depth_sensor().get_depth_scale()) if depth.sensor.is_depth_sensor() else 0.0
    if not unit_m > 0.0:
        raise SourceError(
            f"the {info.title} reports a depth unit of {unit_m:g} m, so its depths mean nothing; "
            "plug it in again, or update its firmware"
        )
    try:
        camera = DepthCamera(
            model=info.model,
            serial=info.serial,
            intrinsics=_lens(depth.profile),
            depth_unit_m=float(f"{unit_m:.7g}"),  # the driver keeps it in single precision
        )
        return Calibration(camera, _lens(color.profile), _pose(depth.profile, color.profile))
    except (ValidationError, ValueError) as error:
        raise SourceError(f"the {info.title} reports a lens or pose that cannot be ({error}); calibrate it") from error


def _lens(profile: Any) -> Intrinsics:
    lens = profile.as_video_stream_profile().get_intrinsics()
    coefficients = tuple(float(value) for value in lens.coeffs)
    if lens.model.name not in list(Distortion) and any(coefficients):
        raise ValueError(f"lens model {lens.model.name}")
    return Intrinsics(
        width=lens.width,
        height=lens.height,
        fx=lens.fx,
        fy=lens.fy,
        cx=lens.ppx,
        cy=lens.ppy,
        distortion=Distortion(lens.model.name) if lens.model.name in list(Distortion) else Distortion.NONE,
        coefficients=coefficients,
    )


def _pose(source: Any, target: Any) -> Matrix4:
    extrinsics = source.get_extrinsics_to(target)
    matrix = np.eye(4)
    matrix[:3, :3] = np.asarray(extrinsics.rotation).reshape(3, 3).T  # the driver counts column by column
    matrix[:3, 3] = extrinsics.translation
    return rigid_transform(matrix)
