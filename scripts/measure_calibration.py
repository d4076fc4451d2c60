"""Compare the calibration with theoretical bounds and with what it states itself, and print the numbers.

    .venv/bin/python scripts/measure_calibration.py [bound] [wrong] [coverage]

Default: all of them. All random numbers are seeded.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "support"))

from simulated_clicks import (
    ClickNoise,
    alignment_covariance,
    cramer_rao,
    expected_length,
    judged_places,
    make_clicks,
)
from tactune.core.calibration.agreement import judge_agreement
from tactune.core.calibration.geometry import mapped
from tactune.core.calibration.points import PointArrays
from tactune.core.calibration.report import bound
from tactune.core.calibration.robust_fit import fit_homography, fit_rigid
from tactune.core.errors import CalibrationError
from tactune.core.sources.simulator.scene import simulator_rig

RIG = simulator_rig()
HOMOGRAPHY = np.array([[1.15, 0.02, -30], [-0.015, 1.18, -20], [2e-5, -3e-5, 1]])
GRID = np.stack(np.meshgrid(np.linspace(0, 639, 20), np.linspace(0, 479, 20)), axis=-1).reshape(-1, 2)


def measure_bound():
    """Twelve clicks, 0.7 px noise in both images and 0.5 mm in depth, against the Cramer-Rao bound."""
    noise = ClickNoise()
    places, true = judged_places(RIG)
    for trials, color_share in ((1000, 0.0), (100, 0.5)):
        rows, start = [], time.perf_counter()
        for seed in range(trials):
            clicks = make_clicks(RIG, 12, seed, noise, color_share)
            error = np.hypot(*(fit_rigid(clicks.noisy, RIG).predict(places) - true).T).mean()
            covariance = alignment_covariance(cramer_rao(clicks.true, RIG, noise), places, RIG)
            rows.append((error, expected_length(covariance)))
        ours, least = np.mean(rows, axis=0)
        print(
            f"12 clicks, {trials} seeds, {100 * color_share:.0f} % in colour: mean alignment error {ours:.3f} px, "
            f"Cramer-Rao {least:.3f} px ({100 * (ours / least - 1):+.1f} %); "
            f"{1e3 * (time.perf_counter() - start) / trials:.0f} ms a trial"
        )


def measure_wrong():
    """Wrong pairs, 10 to 30 px off or anywhere: error over the membrane, and how often all of them are named."""
    places, true = judged_places(RIG)
    for count, wrong, anywhere in ((8, 2, False), (12, 2, False), (12, 2, True), (12, 3, False), (20, 4, False)):
        errors, named, exact, refused = [], 0, 0, 0
        for seed in range(400):
            points, rng = make_clicks(RIG, count, seed).noisy, np.random.default_rng(1000 + seed)
            chosen = rng.choice(count, wrong, replace=False)
            if anywhere:
                points.proximity[chosen] = rng.uniform((0, 0), (639, 479), (wrong, 2))
            else:
                angle, radius = rng.uniform(0, 2 * np.pi, wrong), rng.uniform(10, 30, wrong)
                points.proximity[chosen] += np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
            try:
                fit = fit_rigid(points, RIG)
            except CalibrationError:
                refused += 1
                continue
            rejected = set(np.flatnonzero(~fit.inliers))
            named += set(chosen) <= rejected
            exact += set(chosen) == rejected
            errors.append(np.hypot(*(fit.predict(places) - true).T).mean())
        mean, median, far = np.mean(errors), *np.percentile(errors, (50, 95))
        print(
            f"{wrong} of {count} clicks wrong {'anywhere' if anywhere else 'by 10 to 30 px'}: error mean {mean:.2f}, "
            f"median {median:.2f}, 95 % {far:.2f} px; all named {named / 4:.1f} %, no other {exact / 4:.1f} %, "
            f"refused {refused / 4:.1f} %"
        )


#: Kinds of error and the trials of each with a number of pairs. All but the first are correlated:
#: a field of 0.3 to 1.5 px RMS that is part of what the cameras see, or an error of the clicks alone; radial distortion
#: of 1 to 8 px at the corners; depth wrong by 1 to 5 %; a surface bent by 2 to 8 mm.
ERRORS = {"independent": 160, "field": 60, "field, clicks only": 60, "radial": 60, "depth": 60, "bent": 60}
COUNTS = (8, 12, 20, 60, 300)


def image_error(kind, rng):
    """Return the displacement of proximity pixels (N, 2) for a kind of error."""
    if kind.startswith("field"):  # with a correlation length of 120 to 350 px
        rms = rng.uniform(0.3, 1.5)
        waves, phases = rng.normal(0, 1 / rng.uniform(120, 350), (2, 40, 2)), rng.uniform(0, 2 * np.pi, (2, 40))

        def raw(pixels):
            sums = [np.cos(pixels @ k.T + phase).sum(axis=1) for k, phase in zip(waves, phases, strict=True)]
            return np.stack(sums, axis=1)

        scale = rms / np.sqrt((raw(GRID) ** 2).sum(axis=1).mean())
        return lambda pixels: scale * raw(pixels)
    if kind == "radial":
        size, center = rng.uniform(1, 8) * rng.choice([-1, 1]), np.array([320.0, 240.0])
        return lambda pixels: (pixels - center) * ((pixels - center) ** 2).sum(axis=1, keepdims=True) * size / 400**3
    return np.zeros_like


def bend(rng):
    """Return a quadratic bend (N, 2) tactile pixels -> metres, 2 to 8 mm at the rim."""
    size, shape = 1e-3 * rng.uniform(2, 8) * rng.choice([-1, 1]), rng.standard_normal(3)
    shape /= np.linalg.norm(shape)

    def raised(pixels):
        x, y = ((pixels - (320, 240)) / (240, 180)).T
        return size * np.stack([x**2, x * y, y**2], axis=1) @ shape

    return raised


def plane_trial(kind, count, rng):
    """Fit a homography to clicks with an error: the fit, the pairs, places (M, 3), and their true proximity pixels."""
    places, tactile = GRID[::3], rng.uniform((20, 20), (620, 460), (count, 2))
    proximity, true, error = mapped(HOMOGRAPHY, tactile), mapped(HOMOGRAPHY, places), image_error(kind, rng)
    if kind == "bent":
        raised = bend(rng)
        # parallax of the simulator's cameras, 0.22 px / mm at 0.29 m
        proximity = proximity + np.outer(220 * raised(tactile), (1, 0))
        true = true + np.outer(220 * raised(places), (1, 0))
    true = true + (0.0 if kind == "field, clicks only" else error(true))
    tactile = tactile + rng.normal(0, 0.7, tactile.shape)
    unknown = np.full(count, np.nan)
    proximity = proximity + error(proximity) + rng.normal(0, 0.7, tactile.shape)
    points = PointArrays(tactile, unknown, proximity, np.zeros(count, bool))
    return fit_homography(points, RIG), points.places, np.column_stack([places, np.full(len(places), 0.3)]), true


def rigid_trial(kind, count, rng):
    """As `plane_trial`; the wrong depth is that of the clicks and of the places."""
    points, error = make_clicks(RIG, count, int(rng.integers(1 << 31))).noisy, image_error(kind, rng)
    factor = 1 + (kind == "depth") * rng.uniform(0.01, 0.05) * rng.choice([-1, 1])
    raised = bend(rng) if kind == "bent" else (lambda pixels: 0.0)
    places, true = (side[::4] for side in judged_places(RIG))
    depth = factor * points.tactile_depth_m + raised(points.tactile)
    points = replace(points, tactile_depth_m=depth, proximity=points.proximity + error(points.proximity))
    places = np.column_stack([places[:, :2], factor * places[:, 2] + raised(places[:, :2])])
    true = true + (0.0 if kind == "field, clicks only" else error(true))
    return fit_rigid(points, RIG), points.places, places, true


def measure_coverage():
    """Share of trials in which the true error over the membrane is within the 95 % bound."""
    for model, trial in (("homography", plane_trial), ("rigid", rigid_trial)):
        for kind, repeats in ERRORS.items():
            if (model, kind) == ("homography", "depth"):
                continue
            shares, found, refused = [], [], 0
            for count in COUNTS:
                rows = []
                for seed in range(repeats):
                    try:
                        fit, pairs, at, seen = trial(kind, count, np.random.default_rng((count, seed)))
                    except CalibrationError:
                        refused += 1
                        continue
                    agreement = judge_agreement(fit, pairs, at, RIG)
                    error = np.sqrt(np.mean(np.sum((fit.predict(at) - seen) ** 2, axis=1)))
                    rows.append((error <= bound(agreement.sensitivity(at), fit.degrees), agreement.found))
                within, told = 100 * np.mean(rows, axis=0)
                shares.append(within)
                found.append(told)
            cells = ", ".join(
                f"{count} {within:.0f} ({told:.0f})" for count, within, told in zip(COUNTS, shares, found, strict=True)
            )
            print(
                f"95 % bound, {model}, {kind}: pairs, % within it (error told): {cells}; mean {np.mean(shares):.1f}, "
                f"{refused} refused"
            )


MEASUREMENTS = {
    "bound": measure_bound,
    "wrong": measure_wrong,
    "coverage": measure_coverage,
}

if __name__ == "__main__":
    sys.stdout.reconfigure(line_buffering=True)
    cv2.setNumThreads(1)
    for chosen in sys.argv[1:] or MEASUREMENTS:
        MEASUREMENTS[chosen]()
