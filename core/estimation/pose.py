"""The pose of a known object, tracked from contact patch to contact patch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ..model.arrays import Float64Array
from ..model.frames import Matrix4

Vector3 = tuple[float, float, float]


@dataclass(frozen=True)
class FreeDirection:
    """One motion of the object that the patch does not determine.

    Attributes
    ----------
    name : str
        In words, such as "turning about its axis" or "sliding along its flat face".
    kind : str
        ``turn`` or ``slide``.
    axis : (float, float, float)
        Unit vector in the proximity depth frame: the axis of the turn, or the direction of the slide.
    point_m : (float, float, float)
        A point of the turn's axis; for a slide a point of the patch. Metres, proximity depth frame.
    """

    name: str
    kind: Literal["turn", "slide"]
    axis: Vector3
    point_m: Vector3


@dataclass(frozen=True, eq=False)
class PoseEstimate:
    """The object's pose in one frame.

    Attributes
    ----------
    sequence : int
        The frame's number.
    time_s : float
        The frame's time, seconds.
    T_proximity_object : 4 x 4
        Takes the mesh's coordinates to the proximity depth frame, metres. Free directions are held at the motion that
        was predicted.
    covariance : float64, shape (6, 6)
        Order x, y, z, rx, ry, rz as in ``geometry_msgs/PoseWithCovariance``: position of the mesh's origin, then
        rotation about fixed axes parallel to those of the proximity depth frame; m^2, m rad, rad^2. A free direction
        has a standard deviation of the object's size.
    free : tuple of FreeDirection
        Directions that the patch does not determine.
    residual_m : float
        RMS distance of the patch's points to the mesh, metres; nan without a patch.
    overlap : float
        Share of the patch's points that lie on the mesh, 0 to 1.
    lost : bool
        Whether the pose must not be used: there is no patch, or the mesh does not fit it.
    """

    sequence: int
    time_s: float
    T_proximity_object: Matrix4
    covariance: Float64Array
    free: tuple[FreeDirection, ...]
    residual_m: float
    overlap: float
    lost: bool
