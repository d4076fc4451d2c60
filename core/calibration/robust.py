"""The robust fit of both models: the subset of pairs with the largest evidence, fitted by maximum likelihood.

Each subset of the pairs is a hypothesis: its pairs are right, all others are wrong clicks. Its evidence weighs the
residuals by the known click noise and averages over what is not known (MacKay 2003, *Information Theory, Inference, and
Learning Algorithms*, chapter 28):

- the size of the noise is near the stated one, with an inverse chi-square prior, so the residuals follow a Student t;
- the model predicts the pairs no better before the fit than wrong clicks are (unit information prior; Kass and
  Wasserman 1995), which makes pairs that no other pair confirms count little;
- a wrong pair lies anywhere within an area, and every number of wrong pairs is equally likely.

Subsets are proposed by the models of minimal samples, all of them if they are few. Other subsets whose evidence is
nearly as large stay as rivals: the data do not decide between them, so they add to the uncertainty of the fit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import Generic, Protocol, TypeVar

import numpy as np
from scipy.special import gammaln

from ..errors import CalibrationError
from ..model.arrays import BoolArray, Float64Array, IndexArray
from .maximum_likelihood import Linearised, Measurements, Prior, Solution, condition_number, examine, maximise

Theta = TypeVar("Theta")

#: Smallest share of inliers; with fewer, the outliers might be the right ones.
MIN_INLIER_SHARE = 0.55
#: Above this condition number of the scaled design, the result is dominated by noise.
MAX_CONDITION = 3e4

_EXHAUSTIVE = 700
_SCORED_POINTS = 400
#: Subsets that are fitted, and how often each is improved by what its own fit says about all pairs.
_REFINED, _ROUNDS = 8, 3
#: Many pairs that fit all at once with at most this ratio of observed to stated noise need no proposals.
_USUAL_NOISE = 1.5
#: Up to this number of pairs, all of this is tried, and each pair of the best subset is left out in turn.
_FEW = 10
#: Weight of the stated noise beside the observed one, in degrees of freedom.
_STATED_DEGREES = 12.0
#: A wrong click lies within this distance of the right one, as a rule, pixels.
_WRONG_PX = 150.0
#: Least log evidence against chance, where wrong clicks lie anywhere in the image: for each pair more than the model
#: needs, up to `_SURPLUS` of them.
_SIGNIFICANT, _SURPLUS = np.log(100.0), 3
#: A subset whose log evidence is lower by this much is no rival.
_RIVAL = np.log(1000.0)
_MOST_RIVALS = 6
#: Pairs on which a rival of this weight differs are doubtful.
_DOUBTFUL = 0.05
#: Outliers are searched for a second alignment above this share of all pairs; it counts with this share of inliers.
_MIN_SECOND_SHARE, _SECOND_AGREEMENT = 0.2, 0.7


class Problem(Protocol[Theta]):
    """A model for the robust fit."""

    name: str
    sample_size: int
    measurements: Measurements
    #: Names of the pairs, for messages.
    names: Sequence[str]
    #: Noise of a residual if the stated one is right, pixels, and square pixels per square unit of ``seen``, (N,).
    noise_px: float
    square_pixels: Float64Array
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
class Rival(Generic[Theta]):
    """Another subset that the data do not rule out: its fit, its inliers, and its probability against the best one."""

    theta: Theta
    used: BoolArray
    weight: float


@dataclass(frozen=True, eq=False)
class RobustFit(Generic[Theta]):
    """A fit and its inliers.

    Attributes
    ----------
    solution : Solution
    used : bool, shape (N,)
    condition : float
        Condition number of the scaled design.
    rivals : tuple of Rival
    """

    solution: Solution[Theta]
    used: BoolArray
    condition: float
    rivals: tuple[Rival[Theta], ...] = ()

    @property
    def noise_factor(self) -> float:
        """Observed over stated noise; few pairs chosen to agree say little, so the stated one counts beside them."""
        if self.used.all():
            return self.solution.noise_factor
        return float(np.sqrt((_STATED_DEGREES + self.solution.cost) / (_STATED_DEGREES + self.solution.degrees)))


@dataclass(frozen=True, eq=False)
class _Subset(Generic[Theta]):
    solution: Solution[Theta]
    used: BoolArray
    evidence: float
    #: Squared distance of every pair from the fit of the others, see `examine`.
    distances: Float64Array


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
        Too few pairs agree, or they determine no model; the pairs are named.
    """
    count = len(problem.measurements)
    everything = np.ones(count, bool)
    if use is not None or count == problem.sample_size:
        chosen = everything if use is None else use
        return _finish(problem, _solve(problem, chosen), chosen)
    found = _search(problem, everything)
    if not found:
        _solve(problem, everything)
        if problem.hypotheses(_samples(count, problem.sample_size)):
            raise no_agreement(problem)
        raise CalibrationError(
            f"no {problem.sample_size} of the {count} pairs determine a {problem.name}: "
            "they lie on one line or on each other; spread the points over the image"
        )
    best = found[0]
    surplus = best.used.sum() - problem.sample_size
    against_chance = best.evidence + surplus * np.log(problem.area / (np.pi * _WRONG_PX**2))
    if against_chance < _SIGNIFICANT * min(surplus, _SURPLUS) or best.used.mean() < MIN_INLIER_SHARE:
        raise no_agreement(problem, best.used, best.solution.theta)
    _refuse_second_opinion(problem, best.used)
    rivals = tuple(
        Rival(other.solution.theta, other.used, float(np.exp(other.evidence - best.evidence)))
        for other in found[1 : 1 + _MOST_RIVALS]
    )
    return _finish(problem, best.solution, best.used, rivals)


def rivals_px(fit: RobustFit[Theta], predict: Callable[[Theta], Float64Array]) -> Float64Array:
    """Return how far each rival is from the fit at N places, for its probability, shape (N, 2, K).

    Probabilities below 1 count as their root, because their tails rest on the form of the noise.
    """
    best = predict(fit.solution.theta)
    columns = [rival.weight**0.25 * (predict(rival.theta) - best)[:, :, None] for rival in fit.rivals]
    return np.concatenate([np.zeros((*best.shape, 0)), *columns], axis=2)


def doubtful(fit: RobustFit[Theta]) -> tuple[int, ...]:
    """Return the pairs of which the data do not decide whether they are right."""
    likely = [rival.used != fit.used for rival in fit.rivals if rival.weight > _DOUBTFUL]
    return tuple(np.flatnonzero(np.any(likely, axis=0)).tolist()) if likely else ()


def numbered(count: int) -> list[str]:
    """Return names of pairs that have none."""
    return [str(number) for number in range(1, count + 1)]


def _search(problem: Problem[Theta], among: BoolArray) -> list[_Subset[Theta]]:
    """Return the best subset of some pairs and its rivals, the best first."""
    found: dict[bytes, _Subset[Theta]] = {}
    _refine(problem, among, among, found)
    first = max(found.values(), key=lambda subset: subset.evidence, default=None)
    few = among.sum() <= _FEW
    if few or first is None or first.solution.noise_factor > _USUAL_NOISE or first.used.sum() < 0.8 * among.sum():
        for used in _proposals(problem, among):
            _refine(problem, used, among, found)
    if not found:
        return []
    best = max(found.values(), key=lambda subset: subset.evidence)
    if few:
        for pair in np.flatnonzero(best.used):
            fewer = best.used.copy()
            fewer[pair] = False
            _add(problem, fewer, among, found, best.solution.theta)
    ranked = sorted(found.values(), key=lambda subset: -subset.evidence)
    return [subset for subset in ranked if subset.evidence > ranked[0].evidence - _RIVAL]


def _proposals(problem: Problem[Theta], among: BoolArray) -> list[BoolArray]:
    """Return the most likely subsets under the models of minimal samples: for each model the k nearest pairs."""
    pairs = np.flatnonzero(among)
    some = pairs
    if len(pairs) > _SCORED_POINTS:
        some = np.random.default_rng(1).choice(pairs, _SCORED_POINTS, replace=False)
    thetas = problem.hypotheses(some[_samples(len(some), problem.sample_size)])
    if not thetas:
        return []
    scores = np.stack([_prefix_scores(problem, problem.residuals_px(theta)[some]) for theta in thetas])
    found: dict[bytes, BoolArray] = {}
    wanted = _REFINED if len(pairs) == len(some) else 3
    for entry in np.argsort(-scores, axis=None)[: 20 * wanted]:
        model, size = np.unravel_index(entry, scores.shape)
        residuals = problem.residuals_px(thetas[model])
        share = (size + problem.sample_size + 1) / len(some)
        used = np.zeros(len(among), bool)
        used[pairs[np.argsort(residuals[pairs])[: round(share * len(pairs))]]] = True
        found[used.tobytes()] = used
        if len(found) == wanted:
            break
    return list(found.values())


def _samples(count: int, size: int) -> IndexArray:
    """Return index samples, shape (M, size): all of them if they are few, otherwise random ones."""
    if comb(count, size) <= _EXHAUSTIVE:
        return np.array(list(combinations(range(count), size)), dtype=np.intp)
    rng = np.random.default_rng(0)
    return np.array([rng.choice(count, size, replace=False) for _ in range(_EXHAUSTIVE)], dtype=np.intp)


def _prefix_scores(problem: Problem[Theta], residuals_px: Float64Array) -> Float64Array:
    """Return roughly the log evidence of the k nearest pairs, for each k above the sample size."""
    count, size = len(residuals_px), problem.sample_size
    nearest = np.sort(residuals_px)
    k = np.arange(size + 1, count + 1)
    with np.errstate(over="ignore", invalid="ignore"):
        cost = np.cumsum((nearest / problem.noise_px) ** 2)[size:]
    score = _log_evidence(count, k, size, cost, 2 * (k - size), float(np.log(2 * np.pi * problem.noise_px**2)))
    return np.where(nearest[size:] <= min(problem.largest_px, 1e100), score, -np.inf)


def _log_evidence(
    count: int,
    k: int | IndexArray,
    sample_size: int,
    cost: float | Float64Array,
    degrees: int | IndexArray,
    log_spread: float,
) -> Float64Array:
    """Return the log evidence of k of ``count`` pairs against all pairs being wrong, without the leverage.

    ``log_spread`` is the log of the area over which the noise spreads a pair, pixels squared.
    """
    half, total = _STATED_DEGREES / 2, (_STATED_DEGREES + np.asarray(degrees)) / 2
    student = gammaln(total) - gammaln(half) + (total - half) * -np.log(half)
    student = student - total * np.log1p(np.asarray(cost) / _STATED_DEGREES)
    choices = gammaln(count + 1) - gammaln(np.asarray(k) + 1) - gammaln(count - np.asarray(k) + 1)
    return np.asarray((k - sample_size) * (np.log(np.pi * _WRONG_PX**2) - log_spread) + student - choices)


def _add(
    problem: Problem[Theta], used: BoolArray, among: BoolArray, found: dict[bytes, _Subset[Theta]], near: Theta | None
) -> _Subset[Theta] | None:
    """Fit a subset and keep it, unless it determines no model."""
    key = used.tobytes()
    if key in found:
        return found[key]
    if used.sum() <= problem.sample_size:
        return None
    try:
        start = _start(problem, used) if near is None else near
        solution = maximise(start, problem.measurements.keep(used), problem.linearise, problem.retract, problem.prior)
    except (CalibrationError, np.linalg.LinAlgError):
        return None
    view = examine(solution, problem.measurements, problem.linearise, used)
    k, size = int(used.sum()), problem.sample_size
    log_spread = float(np.mean(np.log(2 * np.pi * view.spread * problem.square_pixels)[used]))
    signs, volumes = np.linalg.slogdet(np.stack([view.information * size / among.sum(), solution.information]))
    if not (signs > 0).all() or condition_number(solution.information) > MAX_CONDITION:
        return None
    evidence = float(_log_evidence(int(among.sum()), k, size, solution.cost, max(solution.degrees, 0), log_spread))
    evidence += float(volumes[0] - volumes[1]) / 2
    if not np.isfinite(evidence) or problem.residuals_px(solution.theta)[used].max() > problem.largest_px:
        return None
    found[key] = _Subset(solution, used, evidence, view.distances)
    return found[key]


def _refine(problem: Problem[Theta], used: BoolArray, among: BoolArray, found: dict[bytes, _Subset[Theta]]) -> None:
    """Fit a subset, and again those pairs that its fit makes likely, while the evidence increases."""
    pairs, size = np.flatnonzero(among), problem.sample_size
    best: _Subset[Theta] | None = None
    for _ in range(_ROUNDS):
        subset = _add(problem, used, among, found, None if best is None else best.solution.theta)
        if subset is None or (best is not None and not subset.evidence > best.evidence):
            return
        best = subset
        distances = subset.distances[pairs]
        order = np.argsort(distances)
        k = np.arange(size + 1, len(pairs) + 1)
        cost = np.cumsum(distances[order])[size:]
        log_spread = float(np.log(2 * np.pi * problem.noise_px**2))
        score = _log_evidence(len(pairs), k, size, cost, 2 * (k - size), log_spread)
        used = np.zeros(len(among), bool)
        used[pairs[order[: k[int(np.nanargmax(score))]]]] = True


def left_out_residuals_px(problem: Problem[Theta], fit: RobustFit[Theta]) -> Float64Array:
    """Return each pair's residual under the fit of the others, shape (N, 2); nan if they determine no model."""
    residuals = problem.residual_vectors_px(fit.solution.theta)
    grown = examine(fit.solution, problem.measurements, problem.linearise, fit.used).left_out[:, :2]
    return np.where(fit.used[:, None], grown * np.sqrt(problem.square_pixels)[:, None], residuals)


def _refuse_second_opinion(problem: Problem[Theta], used: BoolArray) -> None:
    """Raise if the outliers agree on another alignment: either group may be the right one."""
    left = ~used
    if left.sum() < max(problem.sample_size + 3, _MIN_SECOND_SHARE * len(used)):
        return
    found = _search(problem, left)
    if found and found[0].evidence > _SIGNIFICANT * _SURPLUS and found[0].used.sum() >= _SECOND_AGREEMENT * left.sum():
        raise CalibrationError(
            f"the pairs agree on two different alignments: {named(problem, used)} on one {problem.name}, "
            f"{named(problem, found[0].used)} on another; check whether some were clicked in another moment or shifted "
            "by one mark, and for a homography whether they lie at two depths"
        )


def named(problem: Problem[Theta], which: BoolArray, most: int = 8) -> str:
    """Return the names of some pairs: ``"pairs 1, 2 and 4"``."""
    names = [name for name, chosen in zip(problem.names, which, strict=True) if chosen]
    if len(names) > most:
        return f"{len(names)} pairs ({', '.join(names[:most])}, ...)"
    return f"pair {names[0]}" if len(names) == 1 else f"pairs {', '.join(names[:-1])} and {names[-1]}"


def no_agreement(
    problem: Problem[Theta], used: BoolArray | None = None, theta: Theta | None = None
) -> CalibrationError:
    """Return the error for pairs that agree on no model."""
    count = len(problem.measurements)
    found = f"the {count} pairs agree on no {problem.name}: none explains them better than chance"
    if used is not None and theta is not None and not used.all():
        off = problem.residuals_px(theta)[~used]
        found = (
            f"only {int(used.sum())} of the {count} pairs agree on one {problem.name}, and {named(problem, ~used)} "
            f"contradict{'s' if len(off) == 1 else ''} them by {_range(off)} px"
        )
    return CalibrationError(
        f"{found}; check that both images show the same moment and that left and right points are the same places, "
        "delete the wrong pairs or click them again"
    )


def _range(values: Float64Array) -> str:
    low, high = (round(float(min(value, 1e6))) for value in (values.min(), values.max()))
    return f"{low}" if low == high else f"{low} to {high}"


def _start(problem: Problem[Theta], used: BoolArray) -> Theta:
    start = problem.start(used)
    if start is None:
        raise CalibrationError(
            f"the points determine no {problem.name}: they lie on one line or on each other; spread them over the image"
        )
    return start


def _solve(problem: Problem[Theta], used: BoolArray) -> Solution[Theta]:
    if used.sum() < problem.sample_size:
        raise CalibrationError(f"a {problem.name} needs {problem.sample_size} pairs, {int(used.sum())} are left")
    kept = problem.measurements.keep(used)
    return maximise(_start(problem, used), kept, problem.linearise, problem.retract, problem.prior)


def _finish(
    problem: Problem[Theta], solution: Solution[Theta], used: BoolArray, rivals: tuple[Rival[Theta], ...] = ()
) -> RobustFit[Theta]:
    condition = condition_number(solution.information)
    if condition > MAX_CONDITION:
        raise CalibrationError(
            f"the points determine no {problem.name} (condition number {condition:.1e}): they lie almost on one line "
            "or on each other; spread them over the image"
        )
    rms = float(np.sqrt(np.mean(problem.residuals_px(solution.theta)[used] ** 2)))
    if len(used) > problem.sample_size and not rms <= problem.largest_rms_px:
        raise no_agreement(problem)
    return RobustFit(solution, used, condition, rivals)
