"""One robust fit for both models: consensus where it is needed, then maximum likelihood of what agrees."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from scipy.stats import f as f_distribution

from ..errors import CalibrationError
from ..model.arrays import BoolArray, Float64Array, IndexArray
from .consensus import SIGNIFICANT, SMALLEST_SHARE, Consensus, find_consensus, score
from .maximum_likelihood import Linearised, Measurements, Prior, Solution, condition_number, deleted_distances, maximise

Theta = TypeVar("Theta")

#: One honest pair in so many is taken for a wrong one.
_HONEST_LOSS = 100_000
#: Weight of the nominal click noise beside the observed one, in degrees of freedom, while judging pairs.
_NOMINAL_DEGREES = 12
#: Up to this ratio of observed to nominal noise, a fit of all pairs needs no search for a consensus.
_USUAL_NOISE = 1.5
#: Left-out pairs are searched for another alignment from this share of all on, and agree if so many of them do.
_LEAST_SECOND_SHARE, _SECOND_AGREEMENT = 0.2, 0.7
#: Beyond this condition number of the scaled design, noise decides and not the clicks.
LARGEST_CONDITION = 3e4
#: Up to so many pairs are left out one by one; of more, `FOLDS` groups.
LEAVE_ONE_OUT, FOLDS = 60, 10


class Problem(Protocol[Theta]):
    """What the robust fit has to know of a model."""

    name: str
    sample_size: int
    measurements: Measurements
    #: Pixels squared in which a wrong partner may lie.
    area: float
    #: Pixels beyond which a pair contradicts the model, and beyond which the RMS residual is no alignment at all.
    largest_px: float
    largest_rms_px: float
    prior: Prior[Theta] | None

    def linearise(self, theta: Theta, places: Float64Array, camera: IndexArray) -> Linearised:
        """Predict, with derivatives."""

    def retract(self, theta: Theta, step: Float64Array) -> Theta:
        """Step away from theta."""

    def start(self, used: BoolArray) -> Theta | None:
        """Return a first theta from some pairs, or None where they give none."""

    def hypotheses(self, samples: IndexArray) -> list[Theta]:
        """Return the models of index samples (M, sample_size)."""

    def residuals_px(self, theta: Theta) -> Float64Array:
        """Return each pair's distance in proximity pixels, shape (N,), quickly."""

    def residual_vectors_px(self, theta: Theta) -> Float64Array:
        """Return clicked minus predicted pixel of each pair, shape (N, 2), exactly."""


@dataclass(frozen=True, eq=False)
class RobustFit(Generic[Theta]):
    """A fit and the pairs that it rests on.

    Attributes
    ----------
    solution : Solution
    used : bool, shape (N,)
    condition : float
        Condition number of the scaled design.
    log10_nfa : float
        Number of false alarms of the agreement; -inf where there are no surplus pairs to agree.
    """

    solution: Solution[Theta]
    used: BoolArray
    condition: float
    log10_nfa: float


def fit_robustly(problem: Problem[Theta], use: BoolArray | None = None) -> RobustFit[Theta]:
    """Fit a model to the pairs that agree.

    Parameters
    ----------
    problem : Problem
    use : bool, shape (N,), optional
        The pairs to fit, where that is known; otherwise wrong pairs are searched for and left out.

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

    One pair at a time is left out of up to `LEAVE_ONE_OUT` pairs, a tenth of the pairs at a time of more.
    Pairs that the fit does not use keep its own residual; nan where the others determine nothing.
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
        if condition_number(solution.information) > LARGEST_CONDITION:
            residuals[fold] = np.nan
        else:
            residuals[fold] = problem.residual_vectors_px(solution.theta)[fold]
    return residuals


def _search(problem: Problem[Theta], first: Theta | None) -> tuple[Consensus, Theta]:
    def refit(inliers: BoolArray) -> Theta | None:
        solution = _try(problem, inliers)
        return None if solution is None else solution.theta

    count = len(problem.measurements)
    found = find_consensus(
        count,
        problem.sample_size,
        problem.area,
        problem.hypotheses,
        problem.residuals_px,
        refit,
        [] if first is None else [first],
        problem.largest_px,
    )
    if found is None:
        raise CalibrationError(
            f"no {problem.sample_size} of the {count} pairs determine a {problem.name}: "
            "they lie on one line or on each other; spread the points over the image"
        )
    if not found[0].significant:
        raise no_agreement(problem.name, int(found[0].inliers.sum()), count, found[0].log10_nfa)
    return found


def _refuse_second_opinion(problem: Problem[Theta], used: BoolArray) -> None:
    """Refuse a fit whose left-out pairs agree on another alignment: either group may be the right one."""
    left = np.flatnonzero(~used)
    if len(left) < max(problem.sample_size + 3, _LEAST_SECOND_SHARE * len(used)):
        return

    def refit(inliers: BoolArray) -> Theta | None:
        chosen = np.zeros(len(used), bool)
        chosen[left[inliers]] = True
        solution = _try(problem, chosen)
        return None if solution is None else solution.theta

    found = find_consensus(
        len(left),
        problem.sample_size,
        problem.area,
        lambda samples: problem.hypotheses(left[samples]),
        lambda theta: problem.residuals_px(theta)[left],
        refit,
        [],
        problem.largest_px,
    )
    if found is not None and found[0].log10_nfa < SIGNIFICANT and found[0].inliers.mean() >= _SECOND_AGREEMENT:
        raise CalibrationError(
            f"the pairs agree on two different alignments: {int(used.sum())} on one {problem.name}, "
            f"{int(found[0].inliers.sum())} on another; check whether some were clicked in another moment or shifted "
            "by one mark, and for a homography whether they lie at two depths"
        )


def no_agreement(name: str, agreeing: int, count: int, log10_nfa: float) -> CalibrationError:
    """Return the refusal of pairs that do not belong together."""
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
    """Drop and take back pairs until each kept pair is plausible beside all other kept ones."""
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
    limit = per_pair * f_distribution.ppf(1 - 1 / _HONEST_LOSS, per_pair, _NOMINAL_DEGREES + degrees)
    indispensable = used & ~np.isfinite(distance)
    return np.asarray((distance <= limit * noise) | indispensable)


def _finish(problem: Problem[Theta], solution: Solution[Theta], used: BoolArray) -> RobustFit[Theta]:
    condition = condition_number(solution.information)
    if condition > LARGEST_CONDITION:
        raise CalibrationError(
            f"the points determine no {problem.name} (condition number {condition:.1e}): they lie almost on one line "
            "or on each other; spread them over the image"
        )
    residuals = problem.residuals_px(solution.theta)
    count = len(used)
    agreement = score(np.where(used, residuals, np.inf), problem.sample_size, problem.area)
    rms = float(np.sqrt(np.mean(residuals[used] ** 2)))
    few = used.mean() < SMALLEST_SHARE
    if count > problem.sample_size and (few or not rms <= problem.largest_rms_px):
        raise no_agreement(problem.name, int(used.sum()), count, agreement.log10_nfa if few else 0.0)
    return RobustFit(solution, used, condition, agreement.log10_nfa)
