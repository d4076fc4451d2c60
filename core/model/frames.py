"""Cameras, the rig they form, and the frames they record.

Conventions: depth is the z coordinate in a camera's optical frame (x right, y down, z forward). Pixel centres lie at
integers; ``(u, v)`` is ``(column, row)``. ``T_a_b`` transforms coordinates in b to coordinates in a. Lengths are in
metres; raw depth is uint16, with its unit in the camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Field

from ..errors import FrameError
from .arrays import AnyArray, BoolArray, Float32Array, Float64Array, Uint8Array, Uint16Array
from .intrinsics import Frozen, Intrinsics

#: Raw counts that mean *no depth*; a D405 stream really contains 65535.
NO_DEPTH_COUNTS = (0, 65535)

#: A longer translation is a mistake, such as millimetres; the cameras of a rig sit in one housing.
_MAX_SHIFT_M = 3.0
_MAX_CAMERA_SHIFT_M = 1.0
#: Largest depth unit, metres: no camera counts centimetres, but a unit given in millimetres looks like that.
MAX_UNIT_M = 0.01

Row4 = tuple[float, float, float, float]
Matrix4 = tuple[Row4, Row4, Row4, Row4]


def rigid_transform(matrix: Any) -> Matrix4:
    """Return a 4 x 4 matrix, translation in metres, as nested tuples; `ValueError` if it is no rigid transform."""
    try:
        raw = np.asarray(matrix)
    except ValueError as error:
        raise ValueError("a pose is a 4 x 4 matrix, this one has rows of different lengths") from error
    if raw.shape != (4, 4) or raw.dtype.kind not in "iuf":
        raise ValueError(f"a pose is a 4 x 4 matrix of numbers, this one has the shape {raw.shape}, type {raw.dtype}")
    array = raw.astype(np.float64)
    if not np.abs(array[:3]).max() <= _MAX_SHIFT_M:  # also nan
        raise ValueError(f"a pose holds metres up to {_MAX_SHIFT_M:g}, this one larger numbers or nan; is it in mm?")
    rotation = array[:3, :3]
    deviation = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if deviation > 1e-3 or np.linalg.det(rotation) < 0:
        raise ValueError(f"the upper left 3 x 3 is no rotation (R R^T differs from I by {deviation:.2g}) or mirrors")
    if not np.array_equal(array[3], (0.0, 0.0, 0.0, 1.0)):
        raise ValueError(f"the last row of a pose is 0 0 0 1, this one is {array[3].tolist()}")
    rows: Any = tuple(tuple(float(value) for value in row) for row in array)
    return rows  # type: ignore[no-any-return]


def pose_matrix(rotation: npt.ArrayLike, shift_m: npt.ArrayLike) -> Float64Array:
    """Return the pose (4, 4) of a rotation (3, 3) and a translation (3,)."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, shift_m
    return pose


def camera_pose(matrix: Any) -> Matrix4:
    """Return a pose between the cameras of a rig, at most 1 m long, as `rigid_transform` does."""
    pose = rigid_transform(matrix)
    shift = [row[3] for row in pose[:3]]
    if np.linalg.norm(shift) > _MAX_CAMERA_SHIFT_M:
        raise ValueError(
            f"the cameras of a rig are at most {_MAX_CAMERA_SHIFT_M:g} m apart, the translation here is "
            f"{' '.join(f'{value:g}' for value in shift)}: is it in mm? Give metres"
        )
    return pose


#: A field that holds such a pose.
CameraPose = Annotated[Matrix4, BeforeValidator(camera_pose)]


class DepthCamera(Frozen):
    """One depth camera: its identity, its lens, and the length of one raw count in metres."""

    model: str = "unknown"
    serial: str = ""
    intrinsics: Intrinsics
    depth_unit_m: Annotated[float, Field(ge=1e-7, le=MAX_UNIT_M)]


class ColorCamera(Frozen):
    """A colour camera beside a depth camera; ``T_color_depth`` transforms points from the depth frame to its frame."""

    intrinsics: Intrinsics
    T_color_depth: CameraPose


#: Model of the stand-in for the proximity camera of a rig that has a tactile camera only.
NO_CAMERA: Final = "none"


class Rig(Frozen):
    """Both depth cameras of one sensor and their relative pose, if known; or a tactile camera only: `of_one_camera`.

    Without a colour camera, ``proximity_color`` None, the proximity colour image is aligned to the depth image already.
    ``T_proximity_tactile`` is the factory or nominal pose of the tactile depth camera in the proximity depth frame.
    """

    proximity: DepthCamera
    tactile: DepthCamera
    proximity_color: ColorCamera | None = None
    T_proximity_tactile: CameraPose | None = None

    @classmethod
    def of_one_camera(cls, tactile: DepthCamera) -> Rig:
        """Return a rig with a tactile camera only.

        A stand-in with the same lens in the same place is its proximity camera, and the tactile images are that
        camera's images, too (`SensorFrame.of_shots`): so the membrane is what both see, in one frame.
        """
        stand_in = tactile.model_copy(update={"model": NO_CAMERA, "serial": ""})
        return cls(proximity=stand_in, tactile=tactile, T_proximity_tactile=rigid_transform(np.eye(4)))

    @property
    def has_proximity(self) -> bool:
        return self.proximity.model != NO_CAMERA

    @property
    def cameras(self) -> tuple[DepthCamera, ...]:
        """The cameras that the rig really has."""
        return (self.proximity, self.tactile) if self.has_proximity else (self.tactile,)

    @property
    def proximity_color_shape(self) -> tuple[int, int]:
        """Height and width of the proximity colour image in pixels."""
        camera = self.proximity_color.intrinsics if self.proximity_color else self.proximity.intrinsics
        return camera.shape


@dataclass(frozen=True)
class TrueStrain:
    """Largest in-plane strain of the membrane, relative to the flat clamped state."""

    #: Along the membrane's length and width between neighbours of a grid of 10 mm.
    length: float
    width: float
    #: The same over neighbours that the tactile camera sees completely, at least 90 % of each dot.
    length_seen: float
    width_seen: float


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """Ground truth of a frame, from the simulator or a labelled recording, in proximity pixels."""

    contact: BoolArray  # (H, W): Where the membrane touches an object
    #: (H, W), or None: True depth of the membrane in the proximity depth frame, metres; nan where unknown.
    depth_m: Float32Array | None = None
    strain: TrueStrain | None = None  # Not stored in recordings
    #: 4 x 4 or None: Pose of the object in the proximity depth frame, metres; of a pair of objects as a whole. The
    #: object's own frame is that of `simulated_mesh`. Not stored in recordings.
    T_proximity_object: Matrix4 | None = None
    #: Force of the object on the membrane in the proximity depth frame, newtons; contact pressure (H, W) and gauge
    #: pressure of the air, pascals. Not stored in recordings.
    force_n: tuple[float, float, float] | None = None
    pressure_pa: Float32Array | None = None
    inflation_pa: float | None = None


#: Largest time stamp, seconds: what ROS can hold, until 2038.
MAX_TIME_S = 2**31 - 1


def note_number(seen: set[int], number: int) -> None:
    """Add a frame's number to those ``seen``; raise `FrameError` if it is there, or negative."""
    if number < 0:
        raise FrameError(f"a frame has the number {number}; number the frames from 0")
    if number in seen:
        raise FrameError(f"two frames have the number {number}, as in merged recordings; use them one by one")
    seen.add(number)


class Shot(NamedTuple):
    """What one camera took: counts, uint16 (H, W), RGB, uint8 (h, w, 3), if there is any, and when."""

    depth: Uint16Array
    color: Uint8Array | None
    time_s: float


#: The images of a frame.
IMAGES: Final = ("proximity_depth", "tactile_depth", "proximity_color", "tactile_color")


@dataclass(frozen=True, eq=False)
class SensorFrame:
    """One pair of images from both cameras. The arrays become read-only views.

    Attributes
    ----------
    sequence : int
        Number of the frame within its source, from 0.
    proximity_depth, tactile_depth : uint16, shape (H, W)
        Raw counts; 0 and 65535 are *no depth*. Units in the rig.
    proximity_color : uint8, shape (H, W, 3)
        RGB. In the colour camera's own pixels, or in depth pixels where the rig has no colour camera.
    tactile_color : uint8, shape (H, W, 3), or None
        RGB, aligned to the tactile depth image.
    proximity_time_s, tactile_time_s : float
        Timestamps in seconds on one clock.
    truth : GroundTruth or None
    """

    sequence: int
    proximity_depth: Uint16Array
    tactile_depth: Uint16Array
    proximity_color: Uint8Array
    tactile_color: Uint8Array | None = None
    proximity_time_s: float = 0.0
    tactile_time_s: float = 0.0
    truth: GroundTruth | None = None

    def __post_init__(self) -> None:
        if not abs(self.sequence) < 2**63:
            raise FrameError(f"a frame has the number {self.sequence}; numbers have 63 bits")
        for name in ("proximity_time_s", "tactile_time_s"):
            if not abs(getattr(self, name)) <= MAX_TIME_S:  # also nan
                found = getattr(self, name)
                raise FrameError(f"frame {self.sequence}: {name} is {found}, not a number up to {MAX_TIME_S} s")
        for name in IMAGES:
            array = getattr(self, name)
            if array is None and name == "tactile_color":
                continue
            is_color = name.endswith("color")
            dtype, dimensions, shape = (np.uint8, 3, "(H, W, 3)") if is_color else (np.uint16, 2, "(H, W)")
            fits = isinstance(array, np.ndarray) and array.dtype == dtype and array.ndim == dimensions
            if not fits or (is_color and array.shape[2] != 3):
                found = f"{array.dtype}, {array.shape}" if isinstance(array, np.ndarray) else type(array).__name__
                raise FrameError(f"frame {self.sequence}: {name} must be {dtype.__name__}, {shape}, got {found}")
            view = np.ascontiguousarray(array).view()
            view.flags.writeable = False
            object.__setattr__(self, name, view)

    @classmethod
    def of_shots(
        cls, rig: Rig, sequence: int, proximity: Shot | None, tactile: Shot, truth: GroundTruth | None = None
    ) -> SensorFrame:
        """Return a frame of what the cameras took; ``proximity`` is None for a rig with a tactile camera only."""
        near = proximity or tactile  # see `Rig.of_one_camera`
        color = np.zeros((*rig.proximity_color_shape, 3), np.uint8) if near.color is None else near.color
        return cls(sequence, near.depth, tactile.depth, color, tactile.color, near.time_s, tactile.time_s, truth)

    @property
    def skew_s(self) -> float:
        """Tactile minus proximity timestamp, seconds."""
        return self.tactile_time_s - self.proximity_time_s

    def numbers(self) -> dict[str, Any]:
        """Return number and time stamps by name, as files keep them."""
        times = {name: float(getattr(self, name)) for name in ("proximity_time_s", "tactile_time_s")}
        return {"sequence": int(self.sequence), **times}

    def images(self, rig: Rig) -> dict[str, AnyArray]:
        """Return the images and the truth by name, as files keep them; without what is missing or of a stand-in."""
        names = ("proximity_depth", "proximity_color", "tactile_depth", "tactile_color")
        found = {name: getattr(self, name) for name in names if rig.has_proximity or "proximity" not in name}
        if self.truth is not None:
            found |= {"truth_contact": self.truth.contact, "truth_depth_m": self.truth.depth_m}
        return {name: image for name, image in found.items() if image is not None}

    def check_against(self, rig: Rig) -> None:
        """Raise `FrameError` if the size of an image differs from the rig."""
        expected = {
            "proximity_depth": rig.proximity.intrinsics.shape,
            "tactile_depth": rig.tactile.intrinsics.shape,
            "proximity_color": rig.proximity_color_shape,
        }
        for name, shape in expected.items():
            found = getattr(self, name).shape[:2]
            if found != shape:
                raise FrameError(
                    f"frame {self.sequence}: {name} is {found[1]} x {found[0]} pixels, "
                    f"the rig says {shape[1]} x {shape[0]}; use the rig of the camera that took it"
                )
