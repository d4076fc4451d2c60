"""Radial lens distortion estimated from point pairs, where the rig states none.

The radial model is Brown's, ``x (1 + k1 r^2 + k2 r^4)`` in normalised coordinates (Brown 1971; the Brown-Conrady model
of OpenCV and librealsense without tangential terms). The coefficients of both lenses are fitted together with the
tactile camera's pose and a depth offset, or with a homography where the pairs have no tactile depth. An F test decides
between the fits with and without coefficients (Seber and Wild, *Nonlinear Regression*, section 5.3), so a plane seen by
a bending lens is told from pairs on two planes, which no coefficient explains.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import f as f_distribution

from ..model.arrays import BoolArray, Float64Array
from ..model.frames import Rig
from ..model.intrinsics import Distortion, Intrinsics
from .correspondences import Correspondence, on_a_line, pixel_arrays
from .homography import CLICK_SIGMA_PX
from .quality import membrane_places
from .rigid import color_lens, ray_seen, solve_pose, to_color

#: Fewer pairs in an image estimate no distortion of its lens.
MIN_PAIRS = 16
#: Chance of finding distortion where there is none.
_FALSE_ALARM = 1e-4
#: Largest standard deviation of k1 that is offered.
_MAX_SIGMA = 0.05
#: Pairs must reach this share of the way from the centre of an image to its corner.
_MIN_REACH = 0.4
#: Distortion explains the pairs only if the remaining noise is at most this multiple of a careful click's.
_NOISE = 1.5
#: A residual beyond this many standard deviations is a wrong pair's; the largest share of wrong pairs.
_WRONG_SIGMAS, _MAX_WRONG = 4.5, 0.2
#: Prior on the depth offset, metres per pixel of residual: it keeps an undetermined offset finite.
_OFFSET_M = 0.03
#: Two planes: fewest pairs of each, and smallest distance between them, metres.
_MIN_GROUP, _PLANES_M = 7, 0.004
_OFFER = "Estimate lens distortion: "
_LENS_NAMES = {"tactile": "tactile", "proximity": "proximity", "color": "proximity colour"}


@dataclass(frozen=True)
class DistortionAdvice:
    """What the pairs say about radial distortion that the rig does not state.

    Attributes
    ----------
    found : bool
        Whether distortion explains the pairs significantly better.
    rig : Rig or None
        The rig with the estimated coefficients; None if no estimate is offered.
    sentence : str
        The estimate, or what is missing for one; empty if no distortion was found.
    k1 : dict of str to (float, float)
        k1 and its standard deviation by lens: ``"tactile"``, ``"proximity"`` or ``"color"``.
    """

    found: bool = False
    rig: Rig | None = None
    sentence: str = ""
    k1: dict[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def result(self) -> str:
        """The estimate once it is used, one sentence."""
        return f"Estimated lens distortion: {self._estimate}."

    @property
    def refusal(self) -> str:
        """Why the pairs fit no model without distortion, for an error."""
        if self.rig is None:
            return self.sentence[:1].lower() + self.sentence[1:].rstrip(".")
        return f"the pairs fit only with lens distortion ({self._estimate}); estimate it from the pairs"

    @property
    def _estimate(self) -> str:
        return self.sentence.removeprefix(_OFFER).rstrip(".")


def advise_distortion(pairs: Sequence[Correspondence], rig: Rig) -> DistortionAdvice:
    """Estimate radial distortion of the lenses for which the rig states none, if the pairs show one.

    Pairs with tactile depth are fitted with a rigid pose. If fewer than `MIN_PAIRS` have one, a homography tells
    whether a lens bends, but nothing is offered: a homography cannot contain distortion.
    """
    proximity, tactile, depth = pixel_arrays(pairs)
    color = np.array([pair.proximity_image == "color" and rig.proximity_color is not None for pair in pairs], bool)
    known = np.isfinite(depth)
    rigid = int(known.sum()) >= MIN_PAIRS
    usable = known if rigid else color == (2 * color.sum() > len(color))
    clicked = {"tactile": usable, "proximity": usable & ~color, "color": usable & color}
    free = [name for name, lens in _lenses(rig).items() if not lens.has_distortion and clicked[name].sum() >= MIN_PAIRS]
    if not free or on_a_line(tactile[usable]) or on_a_line(proximity[usable]):
        return DistortionAdvice()
    return _judge(
        _Pairs(tactile[usable], depth[usable] if rigid else None, proximity[usable], color[usable], rig, free)
    )


def two_planes(pairs: Sequence[Correspondence], rig: Rig) -> str:
    """Return a sentence if the pairs with depth lie on two planes, each with its own homography; otherwise empty."""
    proximity, tactile, depth = pixel_arrays(pairs)
    left = np.flatnonzero(np.isfinite(depth))
    known, groups = len(left), []
    for _ in range(2):
        if len(left) < _MIN_GROUP:
            return ""
        H, inside = cv2.findHomography(tactile[left], proximity[left], cv2.RANSAC, 4 * CLICK_SIGMA_PX)
        if H is None or inside.sum() < _MIN_GROUP:
            return ""
        groups.append(left[inside.ravel() > 0])
        left = left[inside.ravel() == 0]
    first, second = groups
    ahead = np.column_stack([ray_seen(rig.tactile.intrinsics, tactile), np.ones(len(tactile))])
    space = ahead * depth[:, None]
    centre = space[first].mean(axis=0)
    normal = np.linalg.svd(space[first] - centre)[2][-1]
    apart_m = np.abs((space[second] - centre) @ normal)
    if len(left) > _MAX_WRONG * known or np.median(apart_m) < _PLANES_M:
        return ""
    names = ", ".join(pairs[i].id for i in second[:5]) + (", ..." if len(second) > 5 else "")
    at = [f"{1e3 * np.median(depth[group]):.0f} mm" for group in groups]
    return (
        f"the pairs lie on two planes: {len(first)} on one at {at[0]}, {len(second)} on another at {at[1]} ({names}); "
        "a homography holds for one plane: take the rigid alignment, or disable the pairs of one plane"
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    """A least squares fit. ``theta`` starts with the coefficients: k1 of every free lens, then k2 of every one."""

    order: int
    theta: Float64Array
    sigmas: Float64Array
    cost: float
    degrees: int
    rms_px: float


def _judge(pairs: _Pairs) -> DistortionAdvice:
    found = pairs.robust(1)
    if found is None:
        return DistortionAdvice()
    start, used = found
    n = len(pairs.free)
    plain, bent = pairs.fit(0, used, start[n:]), pairs.fit(1, used, start)
    more = pairs.fit(2, used, np.insert(bent.theta, n, np.zeros(n)))
    if _chance(bent, more) < _FALSE_ALARM and more.sigmas[:n].max() <= _MAX_SIGMA:
        bent = more
    noise_px = np.sqrt(bent.cost / bent.degrees)
    if _chance(plain, bent) >= _FALSE_ALARM or noise_px > _NOISE * np.sqrt(2) * CLICK_SIGMA_PX:
        return DistortionAdvice()
    k1 = {name: (float(bent.theta[i]), float(bent.sigmas[i])) for i, name in enumerate(pairs.free)}
    change = f"residuals fall from {plain.rms_px:.1f} to {bent.rms_px:.1f} px"
    missing = _missing(pairs, used, plain, bent)
    if missing:
        return DistortionAdvice(True, None, f"Lens distortion explains the pairs ({change}), but {missing}.", k1)
    values = ", ".join(f"{value:.2f} ± {sigma:.2f} ({_LENS_NAMES[name]})" for name, (value, sigma) in k1.items())
    sentence = f"{_OFFER}{change}, k1 = {values} from {int(used.sum())} pairs."
    return DistortionAdvice(True, pairs.rig_of(bent), sentence, k1)


def _missing(pairs: _Pairs, used: BoolArray, plain: _Fit, bent: _Fit) -> str:
    """Return what is missing for an estimate; empty if nothing."""
    reach = min(pairs.reach(name, used) for name in pairs.free)
    if pairs.depth_m is None:
        return (
            "a homography cannot contain it; give the pairs their tactile depth, which the rigid alignment needs, or "
            "calibrate the lens with a chessboard"
        )
    if reach < _MIN_REACH:
        return f"the pairs reach only {100 * reach:.0f} % of the way to the corners; add pairs near the border"
    if bent.sigmas[: len(pairs.free)].max() > _MAX_SIGMA:
        return "the pairs do not tell which lens bends; add pairs at other distances, up to the border"
    if pairs.cross_validated_px(bent, used) >= pairs.cross_validated_px(plain, used):
        return "cross-validation does not confirm it; add pairs"
    if not pairs.invertible(pairs.rig_of(bent)):
        return "it is too strong to be removed from the images; calibrate the lens with a chessboard"
    return ""


def _chance(fewer: _Fit, more: _Fit) -> float:
    """Return the probability of so large an improvement by noise alone (F test)."""
    added = fewer.degrees - more.degrees
    ratio = (fewer.cost - more.cost) / added / (more.cost / more.degrees + 1e-12)
    return float(f_distribution.sf(ratio, added, more.degrees))


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Pairs and the free lenses; without ``depth_m`` they are fitted by a homography."""

    tactile: Float64Array
    depth_m: Float64Array | None
    proximity: Float64Array
    color: BoolArray
    rig: Rig
    free: list[str]

    def residuals(self, theta: Float64Array, order: int) -> Float64Array:
        """Return clicked minus predicted proximity pixels, shape (N, 2)."""
        n, lenses = len(self.free), _lenses(self.rig)
        coefficients = theta[: n * order].reshape(order, n)
        k = {name: coefficients[:, i] for i, name in enumerate(self.free)} if order else {}
        pose = theta[n * order :]
        ahead = np.column_stack([_rays(lenses["tactile"], self.tactile, k.get("tactile")), np.ones(len(self.tactile))])
        if self.depth_m is None:
            points = ahead @ np.append(pose, 1.0).reshape(3, 3).T
        else:
            space = ahead * (self.depth_m + pose[6])[:, None]
            points = space @ Rotation.from_rotvec(pose[:3]).as_matrix().T + pose[3:6]
        predicted = np.empty_like(self.proximity)
        for name, which in (("proximity", ~self.color), ("color", self.color)):
            seen = points[which]
            if name == "color" and self.depth_m is not None:
                seen = to_color(self.rig, seen)
            predicted[which] = _pixels(lenses[name], seen, k.get(name))
        return np.asarray(np.nan_to_num(self.proximity - predicted, nan=1e3, posinf=1e3, neginf=-1e3))

    def robust(self, order: int) -> tuple[Float64Array, BoolArray] | None:
        """Return parameters that wrong pairs hardly affect, and the pairs that agree; None if too few do."""
        lenses = _lenses(self.rig)
        rays, of_depth, of_color = (
            _rays(lenses[name], pixels, None)
            for name, pixels in (("tactile", self.tactile), ("proximity", self.proximity), ("color", self.proximity))
        )
        seen = np.where(self.color[:, None], of_color, of_depth)
        if self.depth_m is None:
            H, _ = cv2.findHomography(rays, seen, cv2.LMEDS)
            if H is None:
                return None
            start = (H / H[2, 2]).ravel()[:8]
        else:
            space = np.column_stack([rays, np.ones(len(rays))]) * self.depth_m[:, None]
            pose = solve_pose(space, seen)
            if pose is None:
                return None
            start = np.concatenate([*map(np.ravel, pose), [0.0]])
        theta = np.concatenate([np.zeros(len(self.free) * order), start])
        everything = np.ones(len(self.tactile), bool)
        for scale_px in (10.0, 1.0):
            theta = self._solve(theta, order, everything, loss="soft_l1", f_scale=scale_px).x
        lengths = np.hypot(*self.residuals(theta, order).T)
        sigma = max(float(np.median(lengths)) / 1.177, 0.3)  # median of a Rayleigh distribution
        used = lengths <= _WRONG_SIGMAS * sigma
        return (theta, used) if used.mean() >= 1 - _MAX_WRONG else None

    def fit(self, order: int, used: BoolArray, start: Float64Array) -> _Fit:
        """Fit the pairs that are used by least squares."""
        solved = self._solve(start, order, used)
        squares = (self.residuals(solved.x, order)[used] ** 2).sum(axis=1)
        cost, degrees = float(squares.sum()), max(2 * len(squares) - len(start), 1)
        covariance = np.linalg.pinv(solved.jac.T @ solved.jac) * cost / degrees
        return _Fit(order, solved.x, np.sqrt(np.diag(covariance)), cost, degrees, float(np.sqrt(squares.mean())))

    def cross_validated_px(self, fit: _Fit, used: BoolArray) -> float:
        """Return the RMS residual of six regions of the tactile image, each under the fit of the others."""
        column = np.argsort(np.argsort(self.tactile[:, 0])) * 3 // len(self.tactile)
        region = 2 * column + (self.tactile[:, 1] > np.median(self.tactile[:, 1]))
        squares: list[float] = []
        for held in (used & (region == number) for number in range(6)):
            others = self._solve(fit.theta, fit.order, used & ~held).x
            squares += (self.residuals(others, fit.order)[held] ** 2).sum(axis=1).tolist()
        return float(np.sqrt(np.mean(squares)))

    def reach(self, name: str, used: BoolArray) -> float:
        """Return how far the pairs lie from the centre of an image, as a share of the way to its corner."""
        lens = _lenses(self.rig)[name]
        pixels = self.tactile[used] if name == "tactile" else self.proximity[used & (self.color == (name == "color"))]
        away = np.hypot(*(pixels - (lens.cx, lens.cy)).T)
        return float(np.quantile(away, 0.95) / np.hypot(lens.width / 2, lens.height / 2))

    def rig_of(self, fit: _Fit) -> Rig:
        """Return the rig with the fitted coefficients."""
        n, lenses = len(self.free), _lenses(self.rig)
        for i, name in enumerate(self.free):
            k1, k2 = (*fit.theta[i : n * fit.order : n].tolist(), 0.0)[:2]
            update = {"distortion": Distortion.BROWN_CONRADY, "coefficients": (k1, k2, 0.0, 0.0, 0.0)}
            lenses[name] = lenses[name].model_copy(update=update)
        return self.rig.with_lenses(**lenses)

    def invertible(self, rig: Rig) -> bool:
        """Return whether the rays of membrane and clicks lead back to their pixels under the lenses of a rig."""
        lenses = _lenses(rig)
        membrane = membrane_places(self.tactile, np.full(len(self.tactile), np.nan), rig)[:, :2]
        sides = (("tactile", np.concatenate([self.tactile, membrane])), ("proximity", self.proximity[~self.color]))
        for name, pixels in (*sides, ("color", self.proximity[self.color])):
            with np.errstate(over="ignore", invalid="ignore"):  # beyond the fold of a lens
                rays = ray_seen(lenses[name], pixels)
                again = lenses[name].project(np.column_stack([rays, np.ones(len(rays))]))
            if not np.allclose(again, pixels, atol=0.2):
                return False
        return True

    def _solve(self, start: Float64Array, order: int, used: BoolArray, **options: Any) -> Any:
        def vector(theta: Float64Array) -> Float64Array:
            residuals = self.residuals(theta, order)[used].ravel()
            return residuals if self.depth_m is None else np.append(residuals, theta[-1] / _OFFSET_M)

        return least_squares(vector, start, x_scale="jac", max_nfev=60, **options)


def _lenses(rig: Rig) -> dict[str, Intrinsics]:
    return {"tactile": rig.tactile.intrinsics, "proximity": rig.proximity.intrinsics, "color": color_lens(rig)}


def _rays(lens: Intrinsics, pixels: Float64Array, k: Float64Array | None) -> Float64Array:
    """Return the rays of pixels, with distortion removed by Newton's method on the radius.

    Beyond the fold of a lens the radius stays finite, so the optimiser can come back.
    """
    if k is None:
        return ray_seen(lens, pixels)
    k1, k2 = (*k, 0.0)[:2]
    rays = (pixels - (lens.cx, lens.cy)) / (lens.fx, lens.fy)
    bent = np.hypot(*rays.T)
    radius = bent.copy()
    for _ in range(12):
        square = radius * radius
        slope = np.maximum(1 + (3 * k1 + 5 * k2 * square) * square, 0.1)
        radius = np.clip(radius + (bent - radius * (1 + (k1 + k2 * square) * square)) / slope, 0.0, 2 * bent)
    return np.asarray(rays * (radius / np.maximum(bent, 1e-12))[:, None])


def _pixels(lens: Intrinsics, points: Float64Array, k: Float64Array | None) -> Float64Array:
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        if k is None:
            return lens.project(points)
        k1, k2 = (*k, 0.0)[:2]
        rays = points[:, :2] / points[:, 2:]
        square = (rays**2).sum(axis=1, keepdims=True)
        return np.asarray(rays * (1 + (k1 + k2 * square) * square) * (lens.fx, lens.fy) + (lens.cx, lens.cy))
