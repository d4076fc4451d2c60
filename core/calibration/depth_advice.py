"""Which correction of the tactile depth the pairs call for: offset, scale, both or none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import CalibrationError, minus
from ..model.frames import Rig
from .rigid import DEPTH_FITS, DepthFit, RigidFit, RigidPoints, fit_rigid

#: Standard errors from which a correction counts. One frame of the simulator gives up to 6 where there is none.
MIN_CERTAINTY = 10.0
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
    is `MIN_CERTAINTY` standard errors from none: neighbouring pairs share errors of the tactile depth, which the
    standard errors do not contain. The rig's stated baseline has no say, since a stated pose may be that of a drawing;
    without it, only proximity depths at contact determine a scale.

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
    except CalibrationError as error:
        return DepthAdvice("none", f"No correction of the tactile depth is recommended: {error}.")
    count = full.problem.measurements.keep(full.used).count
    bic = {
        kind: fit.solution.cost / full.noise_factor**2 + fit.parameters * np.log(count) for kind, fit in fits.items()
    }
    best = min((kind for kind in kinds if _certainty(fits[kind]) >= MIN_CERTAINTY), key=lambda kind: bic[kind])
    if best == "none":
        return DepthAdvice(
            best,
            f"No correction of the tactile depth is recommended: an offset would be {_values(fits['offset'])}, and "
            f"{MIN_CERTAINTY:.0f} times are needed.",
        )
    return DepthAdvice(
        best,
        f"Recommended correction of the tactile depth: {DEPTH_WORDS[best]}, {_values(fits[best])}. "
        f"The information criterion BIC is lower by {bic['none'] - bic[best]:.0f} than without.",
    )


def _certainty(fit: RigidFit) -> float:
    """Return how many standard errors the fitted corrections are from none, the smaller number; infinite for none."""
    corrections = zip((fit.pose.scale - 1.0, fit.pose.offset_m), fit.depth_sigma, strict=True)
    return min((abs(value) / sigma for value, sigma in corrections if sigma is not None), default=np.inf)


def _values(fit: RigidFit) -> str:
    """Return the fitted corrections in words, with the certainty of the less certain one."""
    words = []
    if 0 in fit.problem.free:
        words.append(f"× {fit.pose.scale:.4f}")
    if 1 in fit.problem.free:
        words.append(minus(f"{1e3 * fit.pose.offset_m:+.1f} mm"))
    return f"{', '.join(words)} ({_certainty(fit):.0f} times its standard error)"
