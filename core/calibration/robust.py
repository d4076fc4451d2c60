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

from dataclasses import dataclass
from itertools import combinations
from math import comb

import numpy as np
from scipy.special import gammaln

from ..errors import CalibrationError
from ..model.arrays import BoolArray, Float64Array, IndexArray
from .correspondences import listed
from .fit import STATED_DEGREES, Fit, Rival
from .maximum_likelihood import Problem, Solution, condition_number, examine, maximise

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
#: A wrong click lies within this distance of the right one, as a rule, pixels.
_WRONG_PX = 150.0
#: Least log evidence against chance, where wrong clicks lie anywhere in the image: for each pair more than the model
#: needs, up to `_SURPLUS` of them.
_SIGNIFICANT, _SURPLUS = np.log(100.0), 3
#: A subset whose log evidence is lower by this much is no rival.
_RIVAL = np.log(1000.0)
_MOST_RIVALS = 6
#: Outliers are searched for a second alignment above this share of all pairs; it counts with this share of inliers.
_MIN_SECOND_SHARE, _SECOND_AGREEMENT = 0.2, 0.7


@dataclass(frozen=True, eq=False)
class _Subset:
    solution: Solution
    used: BoolArray
    evidence: float
    #: Squared distance of every pair from the fit of the others, see `examine`.
    distances: Float64Array


def fit_robustly(problem: Problem, use: BoolArray | None = None) -> Fit:
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
        return _checked(Fit(problem, _solve(problem, chosen), chosen))
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
    return _checked(Fit(problem, best.solution, best.used, rivals))


def _search(problem: Problem, among: BoolArray) -> list[_Subset]:
    """Return the best subset of some pairs and its rivals, the best first.

    All pairs together are tried first. Minimal samples propose other subsets, unless the pairs are many and all fit.
    """
    found: dict[bytes, _Subset] = {}
    _refine(problem, among, among, found)
    few, all_ = among.sum() <= _FEW, _best(found)
    usual = all_ is not None and all_.solution.noise_factor <= _USUAL_NOISE and all_.used.sum() >= 0.8 * among.sum()
    if few or not usual:
        for used in _proposals(problem, among):
            _refine(problem, used, among, found)
    best = _best(found)
    if best is None:
        return []
    if few:
        for pair in np.flatnonzero(best.used):
            fewer = best.used.copy()
            fewer[pair] = False
            _add(problem, fewer, among, found, best.solution.theta)
    ranked = sorted(found.values(), key=lambda subset: -subset.evidence)
    return [subset for subset in ranked if subset.evidence > ranked[0].evidence - _RIVAL]


def _best(found: dict[bytes, _Subset]) -> _Subset | None:
    return max(found.values(), key=lambda subset: subset.evidence, default=None)


def _proposals(problem: Problem, among: BoolArray) -> list[BoolArray]:
    """Return the most likely subsets under the models of minimal samples: for each model the k nearest pairs."""
    pairs = np.flatnonzero(among)
    some = pairs
    if len(pairs) > _SCORED_POINTS:
        some = np.random.default_rng(1).choice(pairs, _SCORED_POINTS, replace=False)
    thetas = problem.hypotheses(some[_samples(len(some), problem.sample_size)])
    if not thetas:
        return []
    lengths = np.stack([problem.residuals_px(theta) for theta in thetas])
    scores = np.stack([_scores(problem, (own / problem.noise_px) ** 2, problem.largest_px) for own in lengths[:, some]])
    found: dict[bytes, BoolArray] = {}
    wanted = _REFINED if len(pairs) == len(some) else 3
    for entry in np.argsort(-scores, axis=None)[: 20 * wanted]:
        model, size = np.unravel_index(entry, scores.shape)
        share = (size + problem.sample_size + 1) / len(some)
        used = np.zeros(len(among), bool)
        used[pairs[np.argsort(lengths[model, pairs])[: round(share * len(pairs))]]] = True
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


def _scores(problem: Problem, distances: Float64Array, largest_px: float = np.inf) -> Float64Array:
    """Return roughly the log evidence of the k pairs with the smallest squared distance, for each k above the sample.

    Distances are in units of the stated noise; those above ``largest_px`` are rejected.
    """
    size, nearest = problem.sample_size, np.sort(distances)
    k = np.arange(size + 1, len(nearest) + 1)
    with np.errstate(over="ignore", invalid="ignore"):
        cost = np.cumsum(nearest)[size:]
    score = _log_evidence(len(nearest), k, size, cost, 2 * (k - size), np.log(2 * np.pi * problem.noise_px**2))
    allowed = nearest[size:] <= min((largest_px / problem.noise_px) ** 2, 1e200)
    return np.where(allowed & np.isfinite(score), score, -np.inf)


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
    half, total = STATED_DEGREES / 2, (STATED_DEGREES + np.asarray(degrees)) / 2
    student = gammaln(total) - gammaln(half) + (total - half) * -np.log(half)
    student = student - total * np.log1p(np.asarray(cost) / STATED_DEGREES)
    choices = gammaln(count + 1) - gammaln(np.asarray(k) + 1) - gammaln(count - np.asarray(k) + 1)
    return np.asarray((k - sample_size) * (np.log(np.pi * _WRONG_PX**2) - log_spread) + student - choices)


def _add(
    problem: Problem, used: BoolArray, among: BoolArray, found: dict[bytes, _Subset], near: Float64Array | None
) -> _Subset | None:
    """Fit a subset and keep it, unless it determines no model."""
    key = used.tobytes()
    if key in found:
        return found[key]
    if used.sum() <= problem.sample_size:
        return None
    try:
        solution = maximise(problem, used, _start(problem, used) if near is None else near)
    except CalibrationError:
        return None
    view = examine(problem, solution, used)
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


def _refine(problem: Problem, used: BoolArray, among: BoolArray, found: dict[bytes, _Subset]) -> None:
    """Fit a subset, and again those pairs that its fit makes likely, while the evidence increases."""
    pairs = np.flatnonzero(among)
    best: _Subset | None = None
    for _ in range(_ROUNDS):
        subset = _add(problem, used, among, found, None if best is None else best.solution.theta)
        if subset is None or (best is not None and not subset.evidence > best.evidence):
            return
        best, distances = subset, subset.distances[pairs]
        used = np.zeros(len(among), bool)
        used[pairs[np.argsort(distances)[: problem.sample_size + 1 + _scores(problem, distances).argmax()]]] = True


def _refuse_second_opinion(problem: Problem, used: BoolArray) -> None:
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


def named(problem: Problem, which: BoolArray) -> str:
    """Return the names of some pairs: ``"pairs 1, 2 and 4"``."""
    return listed([name for name, chosen in zip(problem.names, which, strict=True) if chosen], 8)


def no_agreement(
    problem: Problem, used: BoolArray | None = None, theta: Float64Array | None = None
) -> CalibrationError:
    """Return the error for pairs that agree on no model."""
    count = len(problem.measurements)
    found = f"the {count} pairs agree on no {problem.name}: none explains them better than chance"
    if used is not None and theta is not None and not used.all():
        off = problem.residuals_px(theta)[~used]
        low, high = (round(float(min(value, 1e6))) for value in (off.min(), off.max()))
        found = (
            f"only {int(used.sum())} of the {count} pairs agree on one {problem.name}, and {named(problem, ~used)} "
            f"contradict{'s' if len(off) == 1 else ''} them by {low if low == high else f'{low} to {high}'} px"
        )
    return CalibrationError(
        f"{found}; check that both images show the same moment and that left and right points are the same places, "
        "delete the wrong pairs or click them again"
    )


def _start(problem: Problem, used: BoolArray) -> Float64Array:
    start = problem.start(used)
    if start is None:
        raise CalibrationError(
            f"the points determine no {problem.name}: they lie on one line or on each other; spread them over the image"
        )
    return start


def _solve(problem: Problem, used: BoolArray) -> Solution:
    if used.sum() < problem.sample_size:
        raise CalibrationError(f"a {problem.name} needs {problem.sample_size} pairs, {int(used.sum())} are left")
    return maximise(problem, used, _start(problem, used))


def _checked(fit: Fit) -> Fit:
    """Return a fit that its pairs determine; raise for another."""
    problem = fit.problem
    if fit.condition > MAX_CONDITION:
        raise CalibrationError(
            f"the points determine no {problem.name} (condition number {fit.condition:.1e}): they lie almost on one "
            "line or on each other; spread them over the image"
        )
    rms = float(np.sqrt(np.mean(problem.residuals_px(fit.solution.theta)[fit.used] ** 2)))
    if len(fit.used) > problem.sample_size and not rms <= problem.largest_rms_px:
        raise no_agreement(problem)
    return fit
