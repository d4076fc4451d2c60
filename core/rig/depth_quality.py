"""Depth quality in a region, as librealsense's Depth Quality Tool defines it, and the bias between both cameras.

The definitions are those of librealsense's tools/depth-quality (readme.md and rs-depth-quality.cpp): fill rate,
plane-fit RMS error, subpixel RMS error, Z accuracy and temporal noise over 40 frames. Two differences: 65535 counts
are no depth, as everywhere in this package, and a pixel that never had depth counts in the fill rate only, while the
tool includes it in the temporal noise and so lowers that.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..contact.alignment import make_alignment, tactile_homography, tactile_pose
from ..contact.kernels.chain import Region
from ..errors import FrameError, RigMismatchError
from ..model.arrays import BoolArray, Float32Array, Float64Array, Int64Array, Uint16Array
from ..model.clouds import ray_table, valid_depth
from ..model.frames import DepthCamera, Rig, SensorFrame
from ..model.robust import spread
from ..preset import AlignmentSection
from ..sources.base import CameraRole

#: Left, top, width, height in pixels.
Rectangle = tuple[int, int, int, int]

#: Number of frames for the temporal noise, as in the tool.
NOISE_FRAMES = 40
#: Fewest depths for a standard deviation.
_MIN_DEPTHS = 5
#: Baselines of Intel's stereo cameras, metres, from their data sheets.
_BASELINES_M = {"D405": 0.018, "D415": 0.055, "D430": 0.050, "D435": 0.050, "D455": 0.095, "D456": 0.095}
#: Share of the points at either end of the depth range that the mean squares leave out, as in the tool.
CLIPPED_SHARE = 1 / 200
_MIN_POINTS = 3
#: Points farther than this share of the median depth from it do not belong to a target that faces the camera.
_STRAY_SHARE = 0.2


@dataclass(frozen=True)
class CameraQuality:
    """Depth quality of one camera in a region; nan for unknown values.

    Attributes
    ----------
    region : (int, int, int, int)
        Left, top, width, height in this camera's pixels.
    frames : int
        Number of frames for the temporal noise.
    fill_rate : float
        Share of the region's pixels with depth in the newest frame, 0 to 1.
    distance_m : float
        Distance of the camera from the fitted plane, metres.
    angle_deg : float
        Angle between the plane's normal and the optical axis, degrees.
    plane_rms_m, plane_rms_share : float
        Root mean square distance of the points from the plane, metres and as a share of ``distance_m``.
    subpixel_rms_px : float
        Root mean square distance as disparity, pixels; stereo cameras only.
    stray_tilt_deg : float
        Angle by which the points that lie more than a fifth off the median depth turn the plane, degrees.
    z_accuracy : float
        Signed error of the plane's distance as a share of the true distance; positive: measured too far.
    temporal_noise_share : float
        Median over the pixels of (standard deviation / median) over the frames.
    temporal_noise_m : float
        Median over the pixels of the standard deviation over the frames, metres.
    """

    role: CameraRole
    model: str
    region: Rectangle
    frames: int
    fill_rate: float
    distance_m: float = float("nan")
    angle_deg: float = float("nan")
    plane_rms_m: float = float("nan")
    plane_rms_share: float = float("nan")
    subpixel_rms_px: float = float("nan")
    stray_tilt_deg: float = 0.0
    z_accuracy: float = float("nan")
    temporal_noise_share: float = float("nan")
    temporal_noise_m: float = float("nan")


@dataclass(frozen=True)
class CameraBias:
    """Bias of the proximity camera's depth against the tactile camera's at the same place.

    Attributes
    ----------
    bias_m : float
        Median of ``dp - dt`` over the pixels of the aligned pair, metres.
    share : float
        ``bias_m`` over the median of ``dp``.
    spread_m : float
        Robust scatter over the pixels: 1.4826 times the median absolute deviation, metres.
    pixels : int
        Number of compared pixels per frame.
    """

    bias_m: float
    share: float
    spread_m: float
    pixels: int


@dataclass(frozen=True)
class DepthQuality:
    """Depth quality of both cameras and the bias between them; ``bias_problem`` says why ``bias`` is None."""

    proximity: CameraQuality
    tactile: CameraQuality
    bias: CameraBias | None
    bias_problem: str = ""


def fill_rate(counts: Uint16Array) -> float:
    """Return the share of pixels with depth, 0 to 1; 0 and 65535 counts are no depth."""
    return float(valid_depth(counts).mean())


def temporal_noise(stack: Sequence[Uint16Array] | Uint16Array, unit_m: float) -> tuple[float, float]:
    """Return the temporal noise of depth in a static scene.

    The standard deviation (normalised by N) and the median of each pixel's valid depths over the frames; the result is
    the median over the pixels.

    Parameters
    ----------
    stack : uint16, N images (H, W)
        Raw counts of one region; the tool uses 40 frames.
    unit_m : float

    Returns
    -------
    (float, float)
        Noise as a share of the distance, and in metres; nan if no pixel has five depths.
    """
    counts = np.asarray(stack)
    valid = valid_depth(counts)
    enough = valid.sum(axis=0) >= _MIN_DEPTHS
    if not enough.any():
        return float("nan"), float("nan")
    depths = counts[:, enough].astype(np.float32)
    missing = ~valid[:, enough]
    number = (~missing).sum(axis=0)
    # centred on one depth of each pixel, so that float32 is precise enough
    origin = np.where(missing, np.float32(0.0), depths).max(axis=0)
    centred = np.where(missing, np.float32(0.0), depths - origin)
    mean = centred.sum(axis=0) / number
    variance = (np.where(missing, np.float32(0.0), centred - mean) ** 2).sum(axis=0) / number
    deviation = np.sqrt(variance)
    median = _median_of_valid(depths, missing, number)
    return float(np.median(deviation / median)), float(np.median(deviation)) * unit_m


def _median_of_valid(depths: Float32Array, missing: BoolArray, number: Int64Array) -> Float32Array:
    """Return each column's median over its valid entries."""
    ordered = np.sort(np.where(missing, np.float32(np.inf), depths), axis=0)
    columns = np.arange(depths.shape[1])
    return np.asarray((ordered[(number - 1) // 2, columns] + ordered[number // 2, columns]) / np.float32(2.0))


def stereo_baseline_m(model: str) -> float | None:
    """Return the baseline of a stereo camera from its model name, metres; None for other cameras."""
    found = re.search(r"D4\d\d", model.upper())
    return _BASELINES_M.get(found[0]) if found else None


def camera_quality(
    role: CameraRole,
    images: Sequence[Uint16Array],
    camera: DepthCamera,
    region: Rectangle,
    true_distance_m: float | None = None,
) -> CameraQuality:
    """Measure one camera in a region.

    Everything but the temporal noise is computed from the last image. The plane is fitted to all points of the region;
    the mean squares leave out the nearest and farthest 0.5 %.

    Parameters
    ----------
    role : "proximity" or "tactile"
    images : sequence of uint16, shape (H, W)
        Whole images, oldest first; at least one, 40 for the tool's temporal noise.
    camera : DepthCamera
    region : (int, int, int, int)
        Left, top, width, height in the camera's pixels.
    true_distance_m : float, optional
        Independently measured distance from the camera to the target along the optical axis, for the Z accuracy.

    Raises
    ------
    FrameError
        The region does not lie within the image.
    """
    window = _window(region, camera, role)
    newest = images[-1][window]
    noise_share, noise_m = temporal_noise([image[window] for image in images], camera.depth_unit_m)
    several = len(images) >= _MIN_DEPTHS
    quality = CameraQuality(
        role=role,
        model=camera.model,
        region=region,
        frames=len(images),
        fill_rate=fill_rate(newest),
        temporal_noise_share=noise_share if several else float("nan"),
        temporal_noise_m=noise_m if several else float("nan"),
    )
    valid = valid_depth(newest)
    depth = newest[valid].astype(np.float64) * camera.depth_unit_m
    rays = ray_table(camera.intrinsics)[window][valid]
    points = np.column_stack([rays * depth[:, None], depth])
    plane = fit_plane(points)
    if plane is None:
        return quality
    kept = clip_depths(points)
    errors = plane.signed_distances(kept)
    rms = root_mean_square(errors)
    baseline = stereo_baseline_m(camera.model)
    median_m = np.median(depth)
    without = fit_plane(points[np.abs(depth - median_m) <= _STRAY_SHARE * median_m])
    turned = 1.0 if without is None else float(np.dot(plane.normal, without.normal))
    quality = replace(
        quality,
        distance_m=plane.distance_m,
        angle_deg=plane.angle_deg,
        stray_tilt_deg=math.degrees(math.acos(min(turned, 1.0))),
        plane_rms_m=rms,
        plane_rms_share=rms / plane.distance_m,
    )
    if baseline is not None:
        errors_px = subpixel_errors(kept, plane, camera.intrinsics.fx, baseline)
        quality = replace(quality, subpixel_rms_px=root_mean_square(errors_px))
    if true_distance_m is not None:
        error = float(np.median(plane.along_axis_m() - true_distance_m + errors))
        quality = replace(quality, z_accuracy=error / true_distance_m)
    return quality


def camera_bias(frames: Sequence[SensorFrame], rig: Rig, section: AlignmentSection, region: Rectangle) -> CameraBias:
    """Compare both cameras on the aligned pair, pixel by pixel, in a region of the proximity image.

    ``dp`` and ``dt`` are the two sides of the tolerance test, including depth scale and offset. The result is valid
    only if both cameras see the same surface, such as a flat, opaque target.

    Raises
    ------
    RigMismatchError
        Neither preset nor rig has the pose between the cameras.
    FrameError
        The region does not lie within the image, or no pixel of it has a depth in both cameras.
    """
    _window(region, rig.proximity, "proximity")
    left, top, width, height = region
    pixels = Region(left, top, left + width, top + height)
    model = make_alignment(section, rig)
    differences, depths = [], []
    for frame in frames:
        aligned = model.align(frame.proximity_depth, frame.tactile_depth, pixels)
        expected = aligned.expected_m[top : top + height, left : left + width].astype(np.float64)
        difference = expected - aligned.measured_m[top : top + height, left : left + width]
        both = np.isfinite(difference)
        differences.append(difference[both])
        depths.append(expected[both])
    values = np.concatenate(differences)
    if len(values) == 0:
        raise FrameError("no pixel of the region has a depth in both cameras; move the region")
    bias = float(np.median(values))
    return CameraBias(
        bias_m=bias,
        share=bias / float(np.median(np.concatenate(depths))),
        spread_m=spread(values, bias),
        pixels=len(values) // len(frames),
    )


def tactile_region(frame: SensorFrame, rig: Rig, section: AlignmentSection, region: Rectangle) -> Rectangle:
    """Return the rectangle of the tactile image that corresponds to a region of the proximity image.

    The region's corners are projected at the region's median proximity depth (rigid) or mapped by the homography.

    Raises
    ------
    RigMismatchError
        Neither preset nor rig has the pose between the cameras.
    FrameError
        The region does not lie within the image, has no depth, or lies outside the tactile image.
    """
    counts = frame.proximity_depth[_window(region, rig.proximity, "proximity")]
    valid = counts[valid_depth(counts)]
    left, top, width, height = region
    right, bottom = left + width - 1, top + height - 1
    corners = np.array([[left, top], [right, top], [left, bottom], [right, bottom]], np.float64)
    if section.model == "homography":
        u, v, w = np.linalg.inv(tactile_homography(section, rig)) @ np.column_stack([corners, np.ones(4)]).T
        pixels = np.column_stack([u / w, v / w])
    else:
        if len(valid) == 0:
            raise FrameError("the proximity camera sees no depth in the region; move it")
        T_t_p = np.linalg.inv(tactile_pose(section, rig))
        depth = float(np.median(valid)) * rig.proximity.depth_unit_m
        points = np.column_stack([rig.proximity.intrinsics.normalise(corners), np.ones(4)]) * depth
        pixels = rig.tactile.intrinsics.project(points @ T_t_p[:3, :3].T + T_t_p[:3, 3])
    limits = np.array([rig.tactile.intrinsics.width, rig.tactile.intrinsics.height])
    first = np.clip(np.rint(pixels.min(axis=0)), 0, limits).astype(int)
    last = np.clip(np.rint(pixels.max(axis=0)) + 1, 0, limits).astype(int)
    if (last - first < 2).any():
        raise FrameError("the tactile camera does not see the region; move it")
    return int(first[0]), int(first[1]), int(last[0] - first[0]), int(last[1] - first[1])


def measure_quality(
    frames: Sequence[SensorFrame],
    rig: Rig,
    section: AlignmentSection,
    region: Rectangle,
    true_distance_m: float | None = None,
) -> DepthQuality:
    """Measure both cameras and the bias between them.

    Parameters
    ----------
    frames : sequence of SensorFrame
        At least one, oldest first; the last 40 are used.
    rig : Rig
    section : AlignmentSection
        The preset's alignment. Without a pose the tactile camera is measured in the same rectangle, without bias.
    region : (int, int, int, int)
        Left, top, width, height in proximity pixels.
    true_distance_m : float, optional
        See `camera_quality`.

    Raises
    ------
    FrameError
        There is no frame, a frame has another size than the rig's, or the region does not lie within the image.
    """
    frames = list(frames)[-NOISE_FRAMES:]
    if not frames:
        raise FrameError("there is no frame to measure; let the source play")
    for frame in frames:
        frame.check_against(rig)
    problem, bias, beside = "", None, _cut(region, rig.tactile)
    try:
        beside = tactile_region(frames[-1], rig, section, region)
        bias = camera_bias(frames[-1:], rig, section, region)
    except (RigMismatchError, FrameError) as error:
        problem = str(error)
    proximity = camera_quality(
        "proximity", [frame.proximity_depth for frame in frames], rig.proximity, region, true_distance_m
    )
    tactile = camera_quality("tactile", [frame.tactile_depth for frame in frames], rig.tactile, beside, true_distance_m)
    return DepthQuality(proximity, tactile, bias, problem)


def _window(region: Rectangle, camera: DepthCamera, role: CameraRole) -> tuple[slice, slice]:
    left, top, width, height = region
    size = camera.intrinsics
    if min(left, top) < 0 or min(width, height) < 1 or left + width > size.width or top + height > size.height:
        raise FrameError(
            f"the region {width} x {height} at ({left}, {top}) does not lie within the {role} image of "
            f"{size.width} x {size.height} pixels; move it"
        )
    return slice(top, top + height), slice(left, left + width)


def _cut(region: Rectangle, camera: DepthCamera) -> Rectangle:
    """Return a region clipped to an image."""
    size = camera.intrinsics
    left, top = min(region[0], size.width - 1), min(region[1], size.height - 1)
    return left, top, min(region[2], size.width - left), min(region[3], size.height - top)


@dataclass(frozen=True)
class Plane:
    """The plane ``normal . p = distance_m``, in the camera's frame, metres.

    Attributes
    ----------
    normal : (float, float, float)
        Unit normal, pointing away from the camera (z > 0).
    distance_m : float
        Distance of the camera's origin from the plane; the tool's "distance to target".
    """

    normal: tuple[float, float, float]
    distance_m: float

    @property
    def angle_deg(self) -> float:
        """Angle between the plane's normal and the optical axis, degrees."""
        return float(np.degrees(np.arccos(min(1.0, abs(self.normal[2])))))

    def along_axis_m(self) -> float:
        """Return the depth at which the optical axis meets the plane, metres."""
        return self.distance_m / self.normal[2]

    def signed_distances(self, points: npt.ArrayLike) -> Float64Array:
        """Return the signed distances of points (N, 3) from the plane, metres; negative is nearer to the camera."""
        return np.asarray(np.asarray(points, np.float64) @ np.asarray(self.normal) - self.distance_m)


def fit_plane(points: npt.ArrayLike) -> Plane | None:
    """Fit a plane by least squares along the axis that the points spread over least.

    The axis is the one whose complementary 2 x 2 minor of the second moments is largest; residuals along it are
    minimised. For a wall in front of a camera this is ordinary least squares ``z = a x + b y + c`` (librealsense,
    tools/depth-quality/depth-metrics.h, ``plane_from_points``). All points are used; clipping comes afterwards.

    Parameters
    ----------
    points : array_like, shape (N, 3)
        Metres in the camera's frame.

    Returns
    -------
    Plane or None
        None for fewer than three points, collinear points, or a plane seen edge-on.
    """
    array = np.asarray(points, dtype=np.float64)
    if len(array) < _MIN_POINTS:
        return None
    centroid = array.mean(axis=0)
    centred = array - centroid
    moments = centred.T @ centred
    others = [[1, 2], [0, 2], [0, 1]]
    minors = [float(np.linalg.det(moments[np.ix_(pair, pair)])) for pair in others]
    axis = int(np.argmax(minors))
    if minors[axis] <= 1e-12 * float(np.trace(moments)) ** 2:
        return None
    slopes = np.linalg.solve(moments[np.ix_(others[axis], others[axis])], moments[others[axis], axis])
    normal = np.zeros(3)
    normal[axis], normal[others[axis]] = 1.0, -slopes
    normal /= np.linalg.norm(normal)
    if abs(normal[2]) < 1e-6:
        return None
    normal *= np.sign(normal[2])
    x, y, z = (float(part) for part in normal)
    return Plane((x, y, z), float(normal @ centroid))


def clip_depths(points: Float64Array) -> Float64Array:
    """Return the points without the nearest and the farthest 0.5 %, ordered by depth.

    This is the tool's only outlier removal (rs-depth-quality.cpp: "Remove outliers [below 0.5% and above 99.5%)").
    """
    ordered = points[np.argsort(points[:, 2], kind="stable")]
    cut = int(len(ordered) * CLIPPED_SHARE)
    return ordered[cut : len(ordered) - cut]


def root_mean_square(values: npt.ArrayLike) -> float:
    """Return ``sqrt(mean(values^2))``."""
    return float(np.sqrt(np.mean(np.square(np.asarray(values, np.float64)))))


def subpixel_errors(points: Float64Array, plane: Plane, focal_px: float, baseline_m: float) -> Float64Array:
    """Return the disparity of each point minus that of its foot on the plane, pixels.

    ``D_i - D'_i = f b / z_i - f b / z'_i``, where ``z'_i`` is the depth of the point's orthogonal projection on
    the plane, as the tool's documentation defines it. (The tool's code divides by the points' distances from the
    camera instead of their depths, which lowers the result towards the image border.)

    Parameters
    ----------
    points : float64, shape (N, 3)
    plane : Plane
    focal_px : float
        Horizontal focal length of the depth image, pixels.
    baseline_m : float
        Stereo baseline, metres.
    """
    foot_z = points[:, 2] - plane.signed_distances(points) * plane.normal[2]
    return np.asarray(focal_px * baseline_m * (1.0 / points[:, 2] - 1.0 / foot_z))
