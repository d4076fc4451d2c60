"""Agreement of regions: whether the errors of a fit are independent, and what they do to the alignment if not.

A missing lens model, a wrong depth or a bent surface moves neighbouring pairs alike. The residuals of a fit show a part
of this; the fit absorbs the rest. Everything here follows from the fit's linearisation, without further fits: with the
whitened design Q (orthonormal columns) and the whitened residuals r,

- a region B left out has the residuals ``(I - Q_B Q_B^T)^-1 r_B`` (Cook and Weisberg, *Residuals and Influence in
  Regression*, section 2.2),
- a smooth error ``F z`` of the pairs, z normal with variance g, has the restricted likelihood of a variance component
  (Patterson and Thompson 1971; Searle, Casella and McCulloch, *Variance Components*, section 6.6). The kinds of error
  are the lens, the depth, the surface and any smooth field. They, independent noise and noise that only near
  neighbours share are weighed by their marginal likelihoods (Kass and Raftery 1995), so the bound grows with the
  evidence, not by a threshold.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import numpy.typing as npt

from ..model.arrays import Float64Array, IndexArray
from ..model.frames import Rig
from .robust_fit import Fit, RigidModel

#: Variances of a smooth error, relative to the noise of a pair, that are tried.
_VARIANCES = np.geomspace(0.003, 300.0, 26)
#: Lengths over which a smooth field changes, as shares of the judged region, and the order of its cosines.
_LENGTHS, _ORDER, _MARGIN = (0.25, 0.4, 0.7), 10, 0.3
#: The same for noise that only near neighbours share, such as a camera's depth noise under many pairs. Such noise may
#: otherwise be mistaken for a smooth error.
_NOISE_LENGTH = 0.1
#: Odds of a smooth error before the pairs are seen. They are chosen for the coverage of the 95 % bound
#: (``scripts/measure_calibration.py coverage``).
_PRIOR_ODDS = 4.0
#: Directions of a smooth error that a fit absorbs almost entirely carry no information.
_ABSORBED = 3e-3
_NEGLIGIBLE = 1e-3
#: A smooth error counts as found from this probability.
_FOUND = 0.98
_MAX_CONDITION = 1e6
_DEPTH_STEP_M = 1e-4

#: What to do about each kind of smooth error.
_STEPS = {
    "lens": "This looks like lens distortion: use the rigid model, with the rig's lens models.",
    "depth": "This looks like a wrong tactile depth: check its unit and the camera, or fit an offset of it.",
    "surface": "The points do not lie on one plane: give tactile depths and use the rigid model.",
    "field": "Check the lens models of both cameras, the tactile depth, and that both images show the same moment.",
}


@dataclass(frozen=True, eq=False)
class Agreement:
    """A fit with smooth errors in its uncertainty: their probability, likeliest cause and cross-validated residual."""

    fit: Fit
    probability: float = 0.0
    cause: str = ""
    cross_validated_px: float | None = None
    noise_ratio: float = 1.0
    shapes: _Shapes | None = None
    errors: tuple[tuple[str, float, Float64Array], ...] = ()
    field_is_true: bool = False

    @property
    def found(self) -> bool:
        """Whether the errors are not independent."""
        return self.probability > _FOUND

    def next_step(self) -> str:
        """Return what to do about the smooth errors that were found."""
        return f"Neighbouring pairs are off in the same direction. {_STEPS[self.cause]}"

    def sensitivity(self, places: npt.ArrayLike) -> Float64Array:
        """Return the derivative (N, 2, P + K) of the error by unit variates of noise and smooth errors."""
        by_noise = self.fit.sensitivity(places)
        columns = [by_noise * self.noise_ratio]
        if self.shapes is not None and self.errors:
            there = self.shapes(np.asarray(places, np.float64))
            for name, size, absorbed in self.errors:
                # what a lens, a depth or a surface does, the cameras see; a field may be an error of the clicks alone
                seen = self.field_is_true if name.startswith("field") else not name.startswith("noise")
                columns.append(by_noise @ absorbed - (size * there[name] if seen else 0.0))
        return np.concatenate(columns, axis=2)


def judge_agreement(fit: Fit, pairs: Float64Array, places: Float64Array, rig: Rig) -> Agreement:
    """Compare regions of a fit with ``pairs`` (N, 3), and judge at ``places`` (M, 3): tactile u, v, depth (m)."""
    if fit.degrees <= 0:
        return Agreement(fit)
    pairs = pairs[fit.inliers]
    design = fit.design[fit.inliers] @ np.linalg.cholesky(fit.stated_covariance)
    residuals = fit.whitened_residuals()[fit.inliers]
    rows = design.reshape(-1, design.shape[2])
    basis = np.linalg.qr(rows)[0]
    rest = residuals.ravel() - basis @ (basis.T @ residuals.ravel())
    by_noise = fit.sensitivity(pairs)
    pixel = float(np.sqrt((by_noise**2).sum() / (rows**2).sum())) / fit.noise_factor
    shapes = _Shapes(fit, rig, pairs, places)
    made = []
    for name, of_pairs in shapes(pairs).items():
        error = np.zeros((*residuals.shape, of_pairs.shape[2]))
        error[:, :2] = of_pairs
        scale = 1.0 / float(np.sqrt((error[:, :2] ** 2).sum() / (2 * len(error))))
        error = scale * error.reshape(len(rest), -1)
        visible = error - basis @ (basis.T @ error)
        log_likelihoods, noises = _variance_component(visible, rest, fit.degrees)
        best = int(log_likelihoods.argmax())
        made.append((name, log_likelihoods, float(noises[best]), _VARIANCES[best], scale, rows.T @ error))
    evidence = np.array([np.exp(np.minimum(log_likelihoods, 600.0)).mean() for _, log_likelihoods, *_ in made])
    # Fields of several lengths and noise are variants of one kind of error: they share one prior.
    priors = [1.0 / (len(_LENGTHS) + 1 if name.startswith(("field", "noise")) else 1) for name, *_ in made]
    odds = _PRIOR_ODDS * evidence * priors / sum(priors)
    kinds = [
        _Kind(name, float(weight), noise, float(np.sqrt(variance * noise)) * float(np.sqrt(weight)), scale, absorbed)
        for (name, _, noise, variance, scale, absorbed), weight in zip(made, odds / (1.0 + odds.sum()), strict=True)
    ]
    observed = float(rest @ rest) / fit.degrees
    noise = (1.0 - sum(kind.weight for kind in kinds)) * observed + sum(kind.weight * kind.noise for kind in kinds)
    crossed = _left_out(basis.reshape(design.shape), rest.reshape(residuals.shape), regions_of(pairs))
    of_clicks = Agreement(
        fit=fit,
        probability=sum(kind.weight for kind in kinds if kind.cause in _STEPS),
        cause=max(_STEPS, key=lambda cause: sum(kind.weight for kind in kinds if kind.cause == cause)),
        cross_validated_px=None if crossed is None else crossed * pixel,
        noise_ratio=float(np.sqrt(noise / observed)) if observed > 0 else 1.0,
        shapes=shapes,
        errors=tuple(
            (kind.name, pixel * kind.scale * kind.size, kind.absorbed * kind.size / fit.noise_factor)
            for kind in kinds
            if kind.weight > _NEGLIGIBLE
        ),
    )
    both = (replace(of_clicks, field_is_true=True), of_clicks)
    return max(both, key=lambda one: float((one.sensitivity(places) ** 2).sum()))


def held_out_px(fit: Fit) -> Float64Array:
    """Return the residual (N, 2) of each used pair under the fit of the others, pixels."""
    design = fit.design[fit.inliers] @ np.linalg.cholesky(fit.stated_covariance)
    basis = np.linalg.qr(design.reshape(-1, design.shape[2]))[0].reshape(design.shape)
    residuals = fit.whitened_residuals()[fit.inliers, :, None]
    without = np.linalg.solve(np.eye(2) - basis @ basis.transpose(0, 2, 1), residuals)
    return np.asarray(np.linalg.solve(fit.whitening[fit.inliers], without)[:, :, 0])


@dataclass(frozen=True, eq=False)
class _Kind:
    """A kind of shared error: its posterior probability, its size, and what the fit absorbs of it (P, K)."""

    name: str
    weight: float
    noise: float
    size: float
    scale: float
    absorbed: Float64Array

    @property
    def cause(self) -> str:
        return self.name.partition(" ")[0]


class _Shapes:
    """The shapes of shared errors at places (N, 3): displacements (N, 2, K) by unit variates, any scale."""

    def __init__(self, fit: Fit, rig: Rig, pairs: Float64Array, places: Float64Array) -> None:
        self.fit, self.rig = fit, rig
        both = np.concatenate([pairs, places])[:, :2]
        self.low, high = both.min(axis=0), both.max(axis=0)
        self.width = np.maximum(high - self.low, 100.0)
        orders = product(range(_ORDER), range(_ORDER))
        self.orders = np.array([order for order in orders if sum(order) < _ORDER])

    def __call__(self, places: Float64Array) -> Mapping[str, Float64Array]:
        proximity = self.fit.predict(places)
        tactile = _centred(places[:, :2], self.rig.tactile.intrinsics.shape)
        x, y = tactile.T
        across = np.stack([np.ones(len(x)), x, y, x**2, x * y, y**2], axis=1)
        radial = [tactile, _centred(proximity, self.rig.proximity.intrinsics.shape)]
        found = {"lens": np.stack([at * (at**2).sum(axis=1, keepdims=True) for at in radial], axis=2)}
        if isinstance(self.fit.model, RigidModel):
            farther = self.fit.predict(places + np.array([0.0, 0.0, _DEPTH_STEP_M]))
            found["depth"] = (farther - proximity)[:, :, None] * across[:, None, :]
        else:
            found["surface"] = _in_both(across[:, 3:])
        inside = (places[:, :2] - self.low) / self.width
        waves = np.pi * self.orders * ((inside[:, None] + _MARGIN) / (1 + 2 * _MARGIN))
        field = np.cos(waves).prod(axis=2) * np.sqrt(2.0) ** (self.orders > 0).sum(axis=1)
        for length in (_NOISE_LENGTH, *_LENGTHS):
            power = np.exp(-((np.pi * self.orders * length / (1 + 2 * _MARGIN)) ** 2) / 2).prod(axis=1)
            kept, kind = power > _NEGLIGIBLE**2, "field" if length in _LENGTHS else "noise"
            found[f"{kind} {length}"] = _in_both(field[:, kept] * np.sqrt(power[kept]))
        return found


def _variance_component(visible: Float64Array, rest: Float64Array, degrees: int) -> tuple[Float64Array, Float64Array]:
    """Return the log likelihood against independent noise, and the variance of the noise, for each of `_VARIANCES`.

    With an error F z, z of variance g s^2 beside noise of variance s^2, the rest r has the covariance s^2 (I + g F F').
    Along the eigenvectors e of F F' with the eigenvalues w, the squares (e'r)^2 are divided by 1 + g w:

        s^2(g) = (r'r - sum (e'r)^2 g w / (1 + g w)) / n
        log L(g) = -n / 2 log(n s^2 / r'r) - sum log(1 + g w) / 2

    ``visible`` is F without what the fit absorbs, shape (M, K).
    """
    total = float(rest @ rest)
    values, vectors = np.linalg.eigh(visible.T @ visible)
    kept = values > _ABSORBED * values[-1]
    values = values[kept]
    along = ((visible.T @ rest) @ vectors[:, kept]) ** 2 / values
    growth = 1.0 + _VARIANCES[:, None] * values
    noise = np.maximum(total - along.sum() + (along / growth).sum(axis=1), 1e-12 * total + 1e-300) / degrees
    return -0.5 * (degrees * np.log(noise * degrees / max(total, 1e-300)) + np.log(growth).sum(axis=1)), noise


def regions_of(pairs: Float64Array) -> list[IndexArray]:
    """Return the number of each pair's region: quarters of the image, or single pairs."""
    u, v = pairs[:, :2].T
    return [2 * (u > np.median(u)).astype(np.intp) + (v > np.median(v)), np.arange(len(pairs))]


def _left_out(basis: Float64Array, residuals: Float64Array, divisions: list[IndexArray]) -> float | None:
    """Return the RMS length of whitened residuals of regions under the fit of the others."""
    for label in divisions:
        squares = 0.0
        for region in np.unique(label):
            own = basis[label == region].reshape(-1, basis.shape[2])
            values, vectors = np.linalg.eigh(np.eye(own.shape[1]) - own.T @ own)
            if values[0] < 1.0 / _MAX_CONDITION:
                break
            rest = residuals[label == region].ravel()
            rest = rest + own @ vectors @ (vectors.T @ (own.T @ rest) / values)  # I + Q (I - Q^T Q)^-1 Q^T
            squares += float(rest @ rest)
        else:
            return float(np.sqrt(squares / len(residuals)))
    return None


def _centred(pixels: Float64Array, shape: tuple[int, int]) -> Float64Array:
    """Return pixels relative to the image's centre, in half diagonals."""
    height, width = shape
    return np.asarray((pixels - ((width - 1) / 2, (height - 1) / 2)) / (np.hypot(width, height) / 2))


def _in_both(columns: Float64Array) -> Float64Array:
    """Return columns (N, K) as displacements along u and along v, shape (N, 2, 2 K)."""
    return np.asarray(np.einsum("nk,ij->nikj", columns, np.eye(2)).reshape(len(columns), 2, -1))
