"""The robust fit of both models: a search for the consensus if needed, then maximum likelihood of the inliers.

The a-contrario criterion (Moisan and Stival 2004; Moulon, Monasse and Marlet 2012) needs no inlier threshold. For each
hypothesis and each radius r it computes the expected number of agreements by chance (number of false alarms): for k of
n pairs within r, with samples of s pairs and an image area a,

    NFA = (n - s) C(n, k) C(k, s) (pi r^2 / a)^(k - s)

The hypothesis and radius with the smallest NFA win. If the NFA is not small, the pairs agree no better than random ones
and are refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import Generic, Protocol, TypeVar

import numpy as np
from scipy.special import gammaln
from scipy.stats import f as f_distribution

from ..errors import CalibrationError
from ..model.arrays import BoolArray, Float64Array, IndexArray
from .maximum_likelihood import Linearised, Measurements, Prior, Solution, condition_number, deleted_distances, maximise

Theta = TypeVar("Theta")

#: A consensus is significant below this log10 of the number of false alarms.
SIGNIFICANT = -3.0
#: Minimum share of inliers; with fewer, the outliers might be the right ones.
MIN_INLIER_SHARE = 0.55
_HYPOTHESES = 700
_FAR_PX = 1e300
_EXHAUSTIVE = 700
_SCORED_POINTS = 400

#: One correct pair in this many is rejected as an outlier.
_CORRECT_PER_REJECTED = 100_000
#: Weight of the nominal click noise beside the observed one, in degrees of freedom, while judging pairs.
_NOMINAL_DEGREES = 12
#: Up to this ratio of observed to nominal noise, all pairs are fitted without a search for a consensus.
_USUAL_NOISE = 1.5
#: Outliers are searched for a second alignment above this share of all pairs; it counts with this share of inliers.
_MIN_SECOND_SHARE, _SECOND_AGREEMENT = 0.2, 0.7
#: Above this condition number of the scaled design, the result is dominated by noise.
MAX_CONDITION = 3e4
#: Cross-validation: leave-one-out up to this number of pairs, beyond that `FOLDS` groups.
LEAVE_ONE_OUT, FOLDS = 60, 10


@dataclass(frozen=True, eq=False)
class Consensus:
    """The inliers of a model, their radius in pixels, and the log10 of the number of false alarms."""

    inliers: BoolArray
    radius_px: float
    log10_nfa: float

    @property
    def significant(self) -> bool:
        """Whether chance is ruled out and at least `MIN_INLIER_SHARE` of the pairs are inliers."""
        return self.log10_nfa < SIGNIFICANT and self.inliers.mean() >= MIN_INLIER_SHARE


def samples(count: int, size: int) -> IndexArray:
    """Return index samples, shape (M, size): all of them if they are few, otherwise random ones."""
    if comb(count, size) <= _EXHAUSTIVE:
        return np.array(list(combinations(range(count), size)), dtype=np.intp)
    rng = np.random.default_rng(0)
    return np.array([rng.choice(count, size, replace=False) for _ in range(_HYPOTHESES)], dtype=np.intp)


def score(residuals_px: Float64Array, sample_size: int, area: float, largest_px: float = np.inf) -> Consensus:
    """Choose the inliers of one hypothesis by the number of false alarms.

    Parameters
    ----------
    residuals_px : float64, shape (N,)
        Residual lengths of one hypothesis; not finite counts as far away.
    sample_size : int
    area : float
        Area over which wrong points are distributed, pixels squared.
    largest_px : float
        Pairs with larger residuals are never inliers.
    """
    count = len(residuals_px)
    order = np.argsort(residuals_px)
    k = np.arange(sample_size + 1, count + 1)
    if len(k) == 0:
        return Consensus(np.ones(count, bool), float(residuals_px.max()), -np.inf)
    radius = residuals_px[order[k - 1]]
    with np.errstate(divide="ignore", invalid="ignore"):
        chance = np.log(np.clip(np.pi * radius**2 / area, 1e-300, 1.0))
    log_nfa = (
        np.log(count - sample_size)
        + _log_binomial(count, k)
        + _log_binomial(k, sample_size)
        + (k - sample_size) * np.where(radius <= min(largest_px, _FAR_PX), chance, 0.0)
    )
    best = int(np.argmin(log_nfa))
    inliers = np.zeros(count, bool)
    inliers[order[: k[best]]] = True
    return Consensus(inliers, float(radius[best]), float(log_nfa[best] / np.log(10)))


def find_consensus(problem: Problem[Theta], pairs: IndexArray, first: list[Theta]) -> tuple[Consensus, Theta] | None:
    """Search for the hypothesis with the fewest false alarms and refine it by refitting.

    Parameters
    ----------
    problem : Problem
    pairs : intp, shape (K,)
        Indices of the pairs to search among; the inliers count within them.
    first : list
        Further hypotheses to try.

    Returns
    -------
    Consensus and theta, or None if no sample determines a model.
    """
    some = np.arange(len(pairs))
    if len(pairs) > _SCORED_POINTS:
        some = np.random.default_rng(1).choice(len(pairs), _SCORED_POINTS, replace=False)
    thetas = [*first, *problem.hypotheses(pairs[some[samples(len(some), problem.sample_size)]])]
    if not thetas:
        return None
    ranked = [(_scored(problem, theta, pairs[some]).log10_nfa, theta) for theta in thetas]
    ranked.sort(key=lambda entry: entry[0])
    refined = [_refined(problem, theta, pairs) for _, theta in ranked[:5]]
    return min(refined, key=lambda found: found[0].log10_nfa)


def _scored(problem: Problem[Theta], theta: Theta, pairs: IndexArray) -> Consensus:
    return score(problem.residuals_px(theta)[pairs], problem.sample_size, problem.area, problem.largest_px)


def _refined(problem: Problem[Theta], theta: Theta, pairs: IndexArray) -> tuple[Consensus, Theta]:
    """Refit a hypothesis to its inliers while the number of false alarms decreases."""
    best = _scored(problem, theta, pairs)
    for _ in range(5):
        inliers = np.zeros(len(problem.measurements), bool)
        inliers[pairs[best.inliers]] = True
        solution = _try(problem, inliers)
        if solution is None:
            break
        found = _scored(problem, solution.theta, pairs)
        if not found.log10_nfa < best.log10_nfa:
            break
        best, theta = found, solution.theta
    return best, theta


def _log_binomial(n: float | IndexArray, k: float | IndexArray) -> Float64Array:
    n, k = np.asarray(n, dtype=np.float64), np.asarray(k, dtype=np.float64)
    return np.asarray(gammaln(n + 1) - gammaln(k + 1) - gammaln(n - k + 1))


class Problem(Protocol[Theta]):
    """A model for the robust fit."""

    name: str
    sample_size: int
    measurements: Measurements
    #: Area over which wrong points are distributed, pixels squared.
    area: float
    #: Largest residual of an inlier, and largest RMS residual of an alignment, pixels.
    largest_px: float
    largest_rms_px: float
    prior: Prior[Theta] | None

    def linearise(self, theta: Theta, places: Float64Array, camera: IndexArray) -> Linearised:
        """Predict, with derivatives."""

    def retract(self, theta: Theta, step: Float64Array) -> Theta:
        """Move theta by a step."""

    def start(self, used: BoolArray) -> Theta | None:
        """Return an initial theta from some pairs, or None if they determine none."""

    def hypotheses(self, samples: IndexArray) -> list[Theta]:
        """Return the models of index samples (M, sample_size)."""

    def residuals_px(self, theta: Theta) -> Float64Array:
        """Return each pair's distance in proximity pixels, shape (N,), quickly."""

    def residual_vectors_px(self, theta: Theta) -> Float64Array:
        """Return clicked minus predicted pixel of each pair, shape (N, 2), exactly."""


@dataclass(frozen=True, eq=False)
class RobustFit(Generic[Theta]):
    """A fit and its inliers.

    Attributes
    ----------
    solution : Solution
    used : bool, shape (N,)
    condition : float
        Condition number of the scaled design.
    log10_nfa : float
        log10 of the number of false alarms of the consensus; -inf without surplus pairs.
    """

    solution: Solution[Theta]
    used: BoolArray
    condition: float
    log10_nfa: float


def fit_robustly(problem: Problem[Theta], use: BoolArray | None = None) -> RobustFit[Theta]:
    """Fit a model to the inliers.

    Parameters
    ----------
    problem : Problem
    use : bool, shape (N,), optional
        Inliers, if already known.

    Raises
    ------
    CalibrationError
        Too few pairs agree, or they determine no model.
    """
    count = len(problem.measurements)
    everything = np.ones(count, bool)
    if use is not None:
        return _finish(problem, _solve(problem, use), use)
    solution = _try(problem, everything)
    if count == problem.sample_size and solution is not None:
        return _finish(problem, solution, everything)
    if solution is not None and solution.noise_factor <= _USUAL_NOISE:
        used, solution = _settle(problem, solution, everything)
        if used.mean() > 0.8:
            return _finish(problem, solution, used)
    consensus, theta = _search(problem, None if solution is None else solution.theta)
    used, solution = _settle(problem, _solve(problem, consensus.inliers, theta), consensus.inliers)
    fit = _finish(problem, solution, used)
    _refuse_second_opinion(problem, used)
    return fit


def left_out_residuals_px(problem: Problem[Theta], fit: RobustFit[Theta]) -> Float64Array:
    """Return each pair's residual under the fit of the others, shape (N, 2): cross-validation.

    Leave-one-out up to `LEAVE_ONE_OUT` pairs, otherwise `FOLDS`-fold. Outliers keep their residual under the fit of all
    inliers; nan if the others determine no model.
    """
    residuals = problem.residual_vectors_px(fit.solution.theta)
    pairs = np.flatnonzero(fit.used)
    folds = len(pairs) if len(pairs) <= LEAVE_ONE_OUT else FOLDS
    shuffled = pairs if folds == len(pairs) else np.random.default_rng(0).permutation(pairs)
    for fold in np.array_split(shuffled, folds):
        others = fit.used.copy()
        others[fold] = False
        left = problem.measurements.keep(others)
        if left.count < len(fit.solution.information):
            residuals[fold] = np.nan
            continue
        solution = maximise(fit.solution.theta, left, problem.linearise, problem.retract, problem.prior)
        if condition_number(solution.information) > MAX_CONDITION:
            residuals[fold] = np.nan
        else:
            residuals[fold] = problem.residual_vectors_px(solution.theta)[fold]
    return residuals


def _search(problem: Problem[Theta], first: Theta | None) -> tuple[Consensus, Theta]:
    count = len(problem.measurements)
    found = find_consensus(problem, np.arange(count), [] if first is None else [first])
    if found is None:
        raise CalibrationError(
            f"no {problem.sample_size} of the {count} pairs determine a {problem.name}: "
            "they lie on one line or on each other; spread the points over the image"
        )
    if not found[0].significant:
        raise no_agreement(problem.name, int(found[0].inliers.sum()), count, found[0].log10_nfa)
    return found


def _refuse_second_opinion(problem: Problem[Theta], used: BoolArray) -> None:
    """Raise if the outliers agree on another alignment: either group may be the right one."""
    left = np.flatnonzero(~used)
    if len(left) < max(problem.sample_size + 3, _MIN_SECOND_SHARE * len(used)):
        return
    found = find_consensus(problem, left, [])
    if found is not None and found[0].log10_nfa < SIGNIFICANT and found[0].inliers.mean() >= _SECOND_AGREEMENT:
        raise CalibrationError(
            f"the pairs agree on two different alignments: {int(used.sum())} on one {problem.name}, "
            f"{int(found[0].inliers.sum())} on another; check whether some were clicked in another moment or shifted "
            "by one mark, and for a homography whether they lie at two depths"
        )


def no_agreement(name: str, agreeing: int, count: int, log10_nfa: float) -> CalibrationError:
    """Return the error for pairs that agree on no model."""
    if log10_nfa < 0 and agreeing < count:
        found = f"only {agreeing} of the {count} pairs agree on one {name}"
    else:
        found = f"the {count} pairs agree on no {name}: none explains them better than chance"
    return CalibrationError(
        f"{found}; check that both images show the same moment and that left and right points are the same places, "
        "delete the wrong pairs or click them again"
    )


def _try(problem: Problem[Theta], used: BoolArray) -> Solution[Theta] | None:
    try:
        return _solve(problem, used)
    except (CalibrationError, np.linalg.LinAlgError):
        return None


def _solve(problem: Problem[Theta], used: BoolArray, near: Theta | None = None) -> Solution[Theta]:
    if used.sum() < problem.sample_size:
        raise CalibrationError(f"a {problem.name} needs {problem.sample_size} pairs, {int(used.sum())} are left")
    start = problem.start(used)
    if start is None:
        start = near
    if start is None:
        raise CalibrationError(
            f"the points determine no {problem.name}: they lie on one line or on each other; spread them over the image"
        )
    return maximise(start, problem.measurements.keep(used), problem.linearise, problem.retract, problem.prior)


def _settle(problem: Problem[Theta], solution: Solution[Theta], used: BoolArray) -> tuple[BoolArray, Solution[Theta]]:
    """Remove and restore pairs until each inlier is plausible under the fit of the other inliers."""
    seen: list[bytes] = []
    while used.tobytes() not in seen:
        seen.append(used.tobytes())
        kept = _plausible(problem, solution, used)
        if kept.sum() < problem.sample_size or (kept == used).all():
            break
        refitted = _try_from(problem, kept, solution.theta)
        if refitted is None:
            break
        used, solution = kept, refitted
    return used, solution


def _try_from(problem: Problem[Theta], used: BoolArray, near: Theta) -> Solution[Theta] | None:
    try:
        return maximise(near, problem.measurements.keep(used), problem.linearise, problem.retract, problem.prior)
    except np.linalg.LinAlgError:
        return None


def _plausible(problem: Problem[Theta], solution: Solution[Theta], used: BoolArray) -> BoolArray:
    per_pair = problem.measurements.seen.shape[1]
    distance = deleted_distances(solution, problem.measurements, problem.linearise, used)
    degrees = np.maximum(solution.degrees - per_pair * used, 0)
    others = np.maximum(solution.cost - np.where(used & np.isfinite(distance), distance, 0.0), 0.0)
    noise = (_NOMINAL_DEGREES + others) / (_NOMINAL_DEGREES + degrees)
    limit = per_pair * f_distribution.ppf(1 - 1 / _CORRECT_PER_REJECTED, per_pair, _NOMINAL_DEGREES + degrees)
    indispensable = used & ~np.isfinite(distance)
    return np.asarray((distance <= limit * noise) | indispensable)


def _finish(problem: Problem[Theta], solution: Solution[Theta], used: BoolArray) -> RobustFit[Theta]:
    condition = condition_number(solution.information)
    if condition > MAX_CONDITION:
        raise CalibrationError(
            f"the points determine no {problem.name} (condition number {condition:.1e}): they lie almost on one line "
            "or on each other; spread them over the image"
        )
    residuals = problem.residuals_px(solution.theta)
    count = len(used)
    agreement = score(np.where(used, residuals, np.inf), problem.sample_size, problem.area)
    rms = float(np.sqrt(np.mean(residuals[used] ** 2)))
    few = used.mean() < MIN_INLIER_SHARE
    if count > problem.sample_size and (few or not rms <= problem.largest_rms_px):
        raise no_agreement(problem.name, int(used.sum()), count, agreement.log10_nfa if few else 0.0)
    return RobustFit(solution, used, condition, agreement.log10_nfa)
