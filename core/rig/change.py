"""Change of both cameras, the membrane's bulge and its visible texture since the untouched frame, from one frame.

A camera that moves by a small rotation w and translation t sees a fixed point P at P + w x P + t. The six numbers
follow from where the membrane's printed texture appears in its colour image; a change of pressure shifts that too
little to matter (2 mm at the apex look like 0.08 mm). What the motion leaves of the change of the tactile depth,
averaged over image tiles, is fitted by a plane (the depth drifts) and a multiple of the bulge (the pressure changes).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from scipy.spatial import cKDTree

from ..calibration.rigid import color_lens, color_pose, ray_seen
from ..contact.alignment import tactile_pose
from ..contact.pipeline import ContactPipeline
from ..errors import CalibrationError, RigMismatchError
from ..model.arrays import BoolArray, Float32Array, Float64Array, Uint8Array, Uint16Array
from ..model.clouds import valid_depth
from ..model.frames import DepthCamera, Rig, SensorFrame
from ..model.intrinsics import Intrinsics
from ..model.robust import spread
from ..preset import Preset
from .drift import MIN_BULGE_M

#: Side length of the image tiles over which depth is averaged, pixels.
_TILE_PX: Final = 16
#: Texture: at most this many places, this far apart, tracked with a window of this side length; pixels.
_MAX_PLACES: Final = 300
_APART_PX: Final = 12.0
_WINDOW_PX: Final = 15
#: Levels of the image pyramid above the first. With a larger scatter about the fitted motion, pixels, texture was
#: matched with its neighbours: the camera has moved too far to be followed.
_LEVELS: Final = 4
_MAX_SCATTER_PX: Final = 2.5
#: Displacement that is followed in any case, metres.
FAR_M: Final = 0.010
#: A place counts as found where tracking it back ends within this distance, pixels.
_RETURN_PX: Final = 0.5
_MIN_PLACES: Final = 20
_MIN_TILES: Final = 60
#: Local contrast is that of log brightness between the first and the last of these Gaussian windows, averaged over a
#: square; the middle one parts it in fine and coarse texture, because blur takes more of the fine one; pixels.
_FINE_PX: Final = 1.0
_MIDDLE_PX: Final = 2.0
_COARSE_PX: Final = 6.0
_SQUARE_PX: Final = 21
#: Grey levels per unit of log contrast in the image that is tracked.
_TRACKED_GAIN: Final = 200.0
#: Brightness below which an 8-bit image is noise; keeps the logarithm finite.
_DARK_LEVELS: Final = 8.0
#: Texture is lost where this share of its contrast is left. If more than the second share of it is lost, the lens
#: explains that no texture is found again, else a motion does.
_LOST_CONTRAST: Final = 0.7
_BLIND: Final = 0.5
#: Contact: the preset's pipeline finds a patch that is larger by this than on the untouched frame, ...
_CONTACT_MM2: Final = 50.0
#: ... or this many neighbouring tiles differ from the fit by more than 4 standard deviations and by more than this.
_DENT_TILES: Final = 7
_DENT_SIGMAS: Final = 4.0
_DENT_M: Final = 0.0008
_ROUNDS: Final = 5
#: Smallest standard deviations that are believed: of a tile's depth, metres, and of a place of texture, pixels.
_LEAST_M: Final = 0.0001
_LEAST_PX: Final = 0.05


@dataclass(frozen=True)
class Change:
    """Change since the untouched frame; None where it could not be measured.

    Attributes
    ----------
    touched : bool
        Whether something touches the membrane; then nothing else is measured.
    tactile_m, proximity_m : float or None
        Root mean square displacement of the membrane's points in a camera's frame as that camera moves, metres. It is
        `FAR_M` if the camera has moved too far to be followed; then its depth and its lens are not measured.
    depth_m : float or None
        Root mean square of the plane that the tactile depth has changed by beyond the camera's motion, metres.
    inflation_m : float or None
        Change of the apex's height above the rim, metres; positive is farther from the cameras.
    inflation_sigma_m : float
        Its standard deviation from the noise of this frame, metres.
    bulge_m : float
        Height of the apex above the rim in the untouched frame, metres.
    tactile_lost, proximity_lost : float or None
        Share of the membrane's texture that a colour image has lost, 0 to 1: the share of places that have lost
        contrast, or what fine texture has lost against coarse texture in their median.
    """

    touched: bool
    tactile_m: float | None = None
    proximity_m: float | None = None
    depth_m: float | None = None
    inflation_m: float | None = None
    inflation_sigma_m: float = 0.0
    bulge_m: float = 0.0
    tactile_lost: float | None = None
    proximity_lost: float | None = None


class ChangeMeter:
    """Compares frames with one untouched frame. What depends on the untouched frame only is computed once.

    Parameters
    ----------
    preset : Preset
        Its alignment relates the two cameras.
    rig : Rig
    untouched : SensorFrame

    Raises
    ------
    CalibrationError
        The untouched frame shows too little of the membrane.
    FrameError
        The untouched frame is of another rig.
    """

    def __init__(self, preset: Preset, rig: Rig, untouched: SensorFrame) -> None:
        untouched.check_against(rig)
        self._rig = rig
        # One look must not depend on earlier ones.
        self._pipeline = ContactPipeline(preset.with_value("membrane.frames", 1), rig)
        self._area_mm2 = self._pipeline.process(untouched).area_mm2
        self._noise_m = 0.0 if preset.noise is None else _tile_noise_m(preset, rig)
        self._surface = _Surface(untouched.tactile_depth, rig.tactile)
        depth_m = _smooth_m(untouched.tactile_depth, rig.tactile)
        self._tactile: _Texture | None = None
        if untouched.tactile_color is not None:
            self._tactile = _Texture(untouched.tactile_color, rig.tactile.intrinsics, _cloud(depth_m, rig.tactile))
        self._proximity: _Texture | None = None
        try:
            T_p_t = tactile_pose(preset.alignment, rig)
        except RigMismatchError:
            return
        section = preset.alignment
        cloud = _cloud(section.depth_scale * depth_m + section.depth_offset_m, rig.tactile)
        T_color_tactile = color_pose(rig) @ T_p_t
        self._proximity = _Texture(
            untouched.proximity_color,
            color_lens(rig),
            cloud @ T_color_tactile[:3, :3].T + T_color_tactile[:3, 3],
        )

    def compare(self, frame: SensorFrame) -> Change:
        """Measure the change in one frame.

        Raises
        ------
        FrameError
            The frame is of another rig.
        """
        frame.check_against(self._rig)
        surface = self._surface
        tactile = proximity = None
        if self._tactile is not None and frame.tactile_color is not None:
            tactile = self._tactile.see(frame.tactile_color)
        motion = None if tactile is None else tactile.motion
        depth = None
        change, known = surface.changes(frame.tactile_depth)
        lost_track = tactile is not None and tactile.lost is None
        if known.sum() >= _MIN_TILES and not lost_track:
            depth = surface.fit(change if motion is None else change - surface.columns @ motion, known, self._noise_m)
        if self._touched(frame, depth):
            return Change(touched=True)
        if self._proximity is not None:
            proximity = self._proximity.see(frame.proximity_color)
        return Change(
            touched=False,
            tactile_m=None if tactile is None else tactile.moved_m,
            proximity_m=None if proximity is None else proximity.moved_m,
            depth_m=None if depth is None else depth.plane_m,
            inflation_m=None if depth is None or surface.bulge_m < MIN_BULGE_M else depth.inflation_m,
            inflation_sigma_m=0.0 if depth is None else depth.inflation_sigma_m,
            bulge_m=surface.bulge_m,
            tactile_lost=None if tactile is None else tactile.lost,
            proximity_lost=None if proximity is None else proximity.lost,
        )

    def _touched(self, frame: SensorFrame, depth: _DepthFit | None) -> bool:
        if depth is not None and depth.dents >= _DENT_TILES:
            return True
        return self._pipeline.process(frame).area_mm2 > self._area_mm2 + _CONTACT_MM2


class _Surface:
    """The untouched membrane in M image tiles, and how its depth changes.

    Attributes
    ----------
    columns : float64, shape (M, 6)
        Derivative of the depth by the camera's motion.
    bulge_m : float
        Height of the apex above the rim.
    """

    def __init__(self, counts: Uint16Array, camera: DepthCamera) -> None:
        self._unit_m = camera.depth_unit_m
        self._grid = (counts.shape[0] // _TILE_PX, counts.shape[1] // _TILE_PX)
        self._before = _tile_means(counts) * self._unit_m
        depth = self._before.reshape(self._grid)
        spacing = _TILE_PX / np.array([camera.intrinsics.fy, camera.intrinsics.fx])
        slope_y, slope_x = (np.asarray(slope).ravel() for slope in np.gradient(depth, *spacing))
        whole = cv2.erode(np.isfinite(depth).astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0)
        self._inner: BoolArray = (whole.ravel() > 0) & np.isfinite(slope_x) & np.isfinite(slope_y)
        if self._inner.sum() < _MIN_TILES:
            raise CalibrationError(
                f"the untouched frame shows the membrane in only {self._inner.sum()} image tiles; check that the "
                "tactile camera sees the membrane, and capture the untouched frame again"
            )
        row, column = np.mgrid[: self._grid[0], : self._grid[1]]
        centres = np.column_stack([column.ravel(), row.ravel()]) * _TILE_PX + (_TILE_PX - 1) / 2
        rays = ray_seen(camera.intrinsics, centres)[self._inner]
        z, x, y = self._before[self._inner], rays[:, 0], rays[:, 1]
        moves = _moves(np.column_stack([x * z, y * z, z]))
        # A point moves by (dX, dY, dZ), and its ray by dx = (dX - x dZ) / z. The tile then shows another point of the
        # surface, so its depth changes by dZ less the slope times the ray's motion.
        ray_dx = (moves[:, 0] - x[:, None] * moves[:, 2]) / z[:, None]
        ray_dy = (moves[:, 1] - y[:, None] * moves[:, 2]) / z[:, None]
        slope_x, slope_y = slope_x[self._inner, None], slope_y[self._inner, None]
        self.columns: Float64Array = moves[:, 2] - slope_x * ray_dx - slope_y * ray_dy
        rim_m, apex_m = (float(depth) for depth in np.quantile(z, [0.02, 0.98]))
        self.bulge_m = apex_m - rim_m
        bulge = (z - rim_m) / self.bulge_m if self.bulge_m >= MIN_BULGE_M else np.zeros_like(z)
        self._shapes = np.column_stack([np.ones_like(z), x, y, bulge])

    def changes(self, counts: Uint16Array) -> tuple[Float64Array, BoolArray]:
        """Return the change of depth of each tile, (M,) metres, and where it is known."""
        change = (_tile_means(counts) * self._unit_m - self._before)[self._inner]
        return change, np.isfinite(change)

    def fit(self, change: Float64Array, known: BoolArray, noise_m: float) -> _DepthFit:
        """Fit plane and bulge to the change of depth, (M,) metres, where it is known."""
        shapes, change = self._shapes[known], change[known]
        fit = _fit(shapes, change, max(_LEAST_M, noise_m))
        left = np.zeros(self._inner.shape)
        left[np.flatnonzero(self._inner)[known]] = np.abs(fit.residuals) > max(_DENT_SIGMAS * fit.sigma, _DENT_M)
        groups = cv2.connectedComponentsWithStats(left.reshape(self._grid).astype(np.uint8), connectivity=8)[2]
        plane = shapes[:, :3] @ fit.values[:3]
        return _DepthFit(
            float(np.sqrt(np.mean(plane**2))),
            float(fit.values[3]),
            float(fit.sigmas[3]),
            int(groups[1:, cv2.CC_STAT_AREA].max(initial=0)),
        )


@dataclass(frozen=True)
class _DepthFit:
    """Plane and bulge in the change of depth, metres, and the largest group of tiles that they do not explain."""

    plane_m: float
    inflation_m: float
    inflation_sigma_m: float
    dents: int


@dataclass(frozen=True, eq=False)
class _Seen:
    """Motion (w, t) of a camera by the texture it sees, None if it is not known; share of the texture that is lost."""

    motion: Float64Array | None
    moved_m: float | None
    lost: float | None


class _Texture:
    """Places with texture on the untouched membrane, in one colour image.

    Parameters
    ----------
    color : uint8, shape (H, W, 3)
    lens : Intrinsics
    cloud : float64, shape (N, 3)
        The membrane in this camera's frame, metres.
    """

    def __init__(self, color: Uint8Array, lens: Intrinsics, cloud: Float64Array) -> None:
        self._lens = lens
        self._image, energies = _contrast(color)
        corners = cv2.goodFeaturesToTrack(self._image, _MAX_PLACES, 0.05, _APART_PX, blockSize=_WINDOW_PX)
        places = np.zeros((0, 2)) if corners is None else corners.reshape(-1, 2).astype(np.float64)
        distance, nearest = cKDTree(lens.project(cloud)).query(places) if len(places) else (np.zeros(0), [])
        height, width = self._image.shape
        kept = (np.asarray(distance) < _WINDOW_PX / 2) & (
            (places > _WINDOW_PX) & (places < (width - _WINDOW_PX, height - _WINDOW_PX))
        ).all(axis=1)
        self.places = places[kept]
        self._energy, self._sharpness = _texture_at(energies, self.places)
        self._rays = ray_seen(lens, self.places)
        z = cloud[np.asarray(nearest, np.intp)[kept], 2]
        self._points: Float64Array = np.column_stack([self._rays * z[:, None], z])
        moves = _moves(self._points)
        shifts = [(moves[:, axis] - self._rays[:, axis, None] * moves[:, 2]) / z[:, None] for axis in range(2)]
        self._columns: Float64Array = np.stack([lens.fx * shifts[0], lens.fy * shifts[1]], axis=1)

    def see(self, color: Uint8Array) -> _Seen | None:
        """Find the texture in another image; None if the untouched frame has too little."""
        if len(self.places) < _MIN_PLACES:
            return None
        image, energies = _contrast(color)
        start = self.places.astype(np.float32).reshape(-1, 1, 2)
        there, ahead = _tracked(self._image, image, start)
        back, behind = _tracked(image, self._image, there)
        moved = there.reshape(-1, 2).astype(np.float64)
        found = ahead & behind & (np.hypot(*(back - start).reshape(-1, 2).T) < _RETURN_PX)
        if found.sum() < _MIN_PLACES:
            lost = self._lost(energies, self.places)
            return _Seen(None, None, lost) if lost > _BLIND else _Seen(None, FAR_M, None)
        rays = ray_seen(self._lens, moved[found]) - self._rays[found]
        flow = rays * (self._lens.fx, self._lens.fy)
        fit = _fit(self._columns[found].reshape(-1, 6), flow.ravel(), _LEAST_PX)
        if fit.sigma > _MAX_SCATTER_PX:
            return _Seen(None, FAR_M, None)
        motion = fit.values
        shifts_m = np.cross(motion[:3], self._points) + motion[3:]
        lost = self._lost(energies, self.places + self._columns @ motion)
        return _Seen(motion, float(np.sqrt(np.mean(np.sum(shifts_m**2, axis=1)))), lost)

    def _lost(self, energies: list[Float32Array], places: Float64Array) -> float:
        """Return the share of texture that is lost at the places where it should be; those outside do not count."""
        height, width = self._image.shape
        inside = ((places > _WINDOW_PX) & (places < (width - _WINDOW_PX, height - _WINDOW_PX))).all(axis=1)
        if inside.sum() < _MIN_PLACES:
            return 0.0
        energy, sharpness = _texture_at(energies, places[inside])
        faded = float(np.mean(energy < _LOST_CONTRAST**2 * self._energy[inside]))
        return max(faded, 1.0 - float(np.median(sharpness / self._sharpness[inside])))


@dataclass(frozen=True, eq=False)
class _Fit:
    """Fitted values and their standard deviations, residuals of all rows and their standard deviation."""

    values: Float64Array
    sigmas: Float64Array
    residuals: Float64Array
    sigma: float


def _fit(columns: Float64Array, wanted: Float64Array, least: float) -> _Fit:
    """Return a robust least squares fit: residuals beyond 3 standard deviations are left out, and it is repeated.

    Parameters
    ----------
    columns : float64, shape (M, K)
    wanted : float64, shape (M,)
    least : float
        Lower limit of the standard deviation of a row.
    """
    kept = np.abs(wanted - np.median(wanted)) <= 3 * max(spread(wanted, float(np.median(wanted))), least)
    for _ in range(_ROUNDS):
        inverse = np.linalg.pinv(columns[kept])
        values = inverse @ wanted[kept]
        residuals = wanted - columns @ values
        sigma = max(spread(residuals, float(np.median(residuals))), least)
        kept = np.abs(residuals) <= 3 * sigma
    return _Fit(values, sigma * np.sqrt(np.sum(inverse**2, axis=1)), residuals, sigma)


def _moves(points: Float64Array) -> Float64Array:
    """Return the derivatives of points (N, 3) by w and t, shape (N, 3, 6)."""
    moves = np.zeros((len(points), 3, 6))
    for axis in range(3):
        moves[:, :, axis] = np.cross(np.eye(3)[axis], points)
    moves[:, :, 3:] = np.eye(3)
    return moves


def _contrast(color: Uint8Array) -> tuple[Uint8Array, list[Float32Array]]:
    """Return an image of local contrast for tracking, and the mean energy of fine and of coarse contrast.

    None depends on the exposure.
    """
    gray = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY).astype(np.float32)
    logs = np.log(cv2.GaussianBlur(gray, (0, 0), _FINE_PX) + _DARK_LEVELS)
    middle, coarse = (cv2.GaussianBlur(logs, (0, 0), width) for width in (_MIDDLE_PX, _COARSE_PX))
    image = np.clip(np.rint(128.0 + _TRACKED_GAIN * (logs - coarse)), 0, 255).astype(np.uint8)
    square = (_SQUARE_PX, _SQUARE_PX)
    return image, [np.asarray(cv2.sqrBoxFilter(band, cv2.CV_32F, square)) for band in (logs - middle, middle - coarse)]


def _texture_at(energies: list[Float32Array], places: Float64Array) -> tuple[Float64Array, Float64Array]:
    """Return the energy of contrast at places, and the ratio of fine to coarse contrast there."""
    fine, coarse = (_sampled(energy, places) for energy in energies)
    return fine + coarse, np.sqrt(fine / coarse)


def _tracked(source: Uint8Array, target: Uint8Array, start: Float32Array) -> tuple[Float32Array, BoolArray]:
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 30, 0.005)
    places, found, _ = cv2.calcOpticalFlowPyrLK(
        source,
        target,
        start,
        np.empty_like(start),
        winSize=(_WINDOW_PX, _WINDOW_PX),
        maxLevel=_LEVELS,
        criteria=criteria,
    )
    return np.asarray(places, np.float32), np.asarray(found).ravel() == 1


def _sampled(image: Float32Array, places: Float64Array) -> Float64Array:
    height, width = image.shape
    u = np.clip(np.rint(places[:, 0]), 0, width - 1).astype(np.intp)
    v = np.clip(np.rint(places[:, 1]), 0, height - 1).astype(np.intp)
    return np.asarray(image[v, u], np.float64) + 1e-9


def _tile_means(counts: Uint16Array) -> Float64Array:
    """Return the mean of the valid counts of each image tile, shape (M,); nan where most pixels have no depth.

    The median would jump from one disparity of the matcher to the next.
    """
    rows, columns = (size // _TILE_PX for size in counts.shape)
    valid = valid_depth(counts)[: rows * _TILE_PX, : columns * _TILE_PX]
    kept = np.where(valid, counts[: valid.shape[0], : valid.shape[1]], 0).astype(np.float64)
    known, total = (
        image.reshape(rows, _TILE_PX, columns, _TILE_PX).sum(axis=(1, 3)).ravel() for image in (valid, kept)
    )
    return np.where(known >= _TILE_PX**2 // 2, total / np.maximum(known, 1), np.nan)


def _smooth_m(counts: Uint16Array, camera: DepthCamera) -> Float64Array:
    """Return the depth without the noise of single pixels, nan where there is none."""
    median = np.asarray(cv2.medianBlur(counts, 5), np.uint16)
    return np.where(valid_depth(median), median * camera.depth_unit_m, np.nan)


def _cloud(depth_m: Float64Array, camera: DepthCamera) -> Float64Array:
    """Return every fourth point with depth, (N, 3) in the tactile frame, metres."""
    v, u = np.mgrid[: depth_m.shape[0] : 2, : depth_m.shape[1] : 2]
    z = depth_m[v, u].ravel()
    seen = np.isfinite(z)
    rays = ray_seen(camera.intrinsics, np.column_stack([u.ravel(), v.ravel()])[seen])
    return np.column_stack([rays * z[seen, None], z[seen]])


def _tile_noise_m(preset: Preset, rig: Rig) -> float:
    """Return the standard deviation of the difference of two tiles' mean depth by the rig's measured noise."""
    assert preset.noise is not None
    camera = preset.noise.tactile
    focal_px = rig.tactile.intrinsics.fx
    area_m2 = (_TILE_PX * camera.distance_m / focal_px) ** 2
    return float(np.sqrt(camera.changing_share * camera.density_m4(focal_px) / area_m2))
