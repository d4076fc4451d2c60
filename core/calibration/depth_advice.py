"""Which correction of the tactile depth the pairs call for: offset, scale, both or none."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as t_distribution

from ..errors import CalibrationError
from ..model.arrays import Float64Array, IndexArray
from ..model.frames import Rig
from .rigid import DEPTH_FITS, DepthFit, RigidFit, RigidPoints, fit_rigid

#: A correction counts if chance alone gives one as large only this often.
_CHANCE = 0.001
#: Regions of the tactile image, columns and rows, for the standard errors.
_REGIONS = (3, 2)
#: Fewer pairs determine no correction.
_MIN_PAIRS = 12
DEPTH_WORDS: dict[DepthFit, str] = {
    "none": "none",
    "offset": "offset only",
    "scale": "scale only",
    "both": "offset and scale",
}


@dataclass(frozen=True)
class DepthAdvice:
    """The correction to fit, and why in one sentence."""

    depth_fit: DepthFit
    reason: str


def advise_depth_fit(points: RigidPoints, rig: Rig) -> DepthAdvice:
    """Compare all corrections of the tactile depth by the Bayesian information criterion (Schwarz 1978).

    All are fitted to the same inliers with the same noise, those of the fit with most parameters:
    ``BIC = cost + P ln n`` for P parameters and n measurements. A correction is a candidate only if each of its values
    differs from none beyond chance (Student's t). Neighbouring pairs share errors of the tactile depth, so the standard
    errors are those of a delete-a-group jackknife over regions of the image (Shao and Tu, *The Jackknife and
    Bootstrap*, 1995, section 2.3), or those of the fit where they are larger. The rig's stated baseline has no say,
    since a stated pose may be that of a drawing; without it, only proximity depths at contact determine a scale.

    Parameters
    ----------
    points : RigidPoints
    rig : Rig
    """
    if len(points.tactile) < _MIN_PAIRS:
        return DepthAdvice("none", f"No correction of the tactile depth: it needs {_MIN_PAIRS} pairs.")
    unstated = rig.model_copy(update={"T_proximity_tactile": None})
    try:
        kinds = DEPTH_FITS if np.isfinite(points.proximity_depth_m).any() else DEPTH_FITS[:2]
        full = fit_rigid(points, unstated, depth_fit=kinds[-1])
        fits = {kind: fit_rigid(points, unstated, depth_fit=kind, like=full) for kind in kinds}
        sigmas = {kind: _sigmas(points, unstated, kind, full) for kind in kinds}
    except CalibrationError as error:
        return DepthAdvice("none", f"No correction of the tactile depth is recommended: {error}.")
    count = full.problem.measurements.keep(full.used).count
    bic = {kind: fit.fit.solution.cost + fit.parameters * np.log(count) for kind, fit in fits.items()}
    limit = t_distribution.ppf(1 - _CHANCE / 2, np.prod(_REGIONS) - 1)
    certain = [kind for kind in kinds if (np.abs(_corrections(fits[kind])) >= limit * sigmas[kind]).all()]
    best = min(certain, key=lambda kind: bic[kind])
    if best == "none":
        return DepthAdvice(
            best,
            "No correction of the tactile depth is recommended: an offset would be "
            f"{_values(fits['offset'], sigmas['offset'])}, which may be chance.",
        )
    return DepthAdvice(
        best,
        f"Recommended correction of the tactile depth: {DEPTH_WORDS[best]}, {_values(fits[best], sigmas[best])}. "
        f"This is beyond chance; the information criterion BIC is lower by {bic['none'] - bic[best]:.0f} than without.",
    )


def _corrections(fit: RigidFit) -> Float64Array:
    """Return how far scale (no unit) and offset (m) are from none, shape (2,)."""
    return np.array([fit.pose.scale - 1.0, fit.pose.offset_m])


def _sigmas(points: RigidPoints, rig: Rig, kind: DepthFit, like: RigidFit) -> Float64Array:
    """Return the standard errors of scale and offset, shape (2,): the jackknife's, or the fit's if larger."""
    region = _regions(points.tactile)
    left_out = [
        _corrections(fit_rigid(points, rig, depth_fit=kind, like=replace(like, used=like.used & (region != number))))
        for number in range(region.max() + 1)
    ]
    jackknife = np.sqrt((len(left_out) - 1) * np.var(left_out, axis=0))
    of_fit = [sigma or 0.0 for sigma in fit_rigid(points, rig, depth_fit=kind, like=like).depth_sigma]
    return np.asarray(np.maximum(jackknife, of_fit))


def _regions(tactile: Float64Array) -> IndexArray:
    """Return the region (N,) of each tactile pixel (N, 2): columns with equally many pairs, each cut into rows."""
    columns, rows = _REGIONS
    region = np.zeros(len(tactile), np.intp)
    for column, among in enumerate(np.array_split(np.argsort(tactile[:, 0]), columns)):
        for row, pairs in enumerate(np.array_split(among[np.argsort(tactile[among, 1])], rows)):
            region[pairs] = column * rows + row
    return region


def _values(fit: RigidFit, sigma: Float64Array) -> str:
    """Return the fitted corrections with their standard errors, in words."""
    words = []
    if 0 in fit.problem.free:
        words.append(f"× {fit.pose.scale:.4f} ± {sigma[0]:.4f}")
    if 1 in fit.problem.free:
        words.append(f"{1e3 * fit.pose.offset_m:+.1f} ± {1e3 * sigma[1]:.1f} mm")
    return ", ".join(words)
