"""The noise of both depth cameras, measured on frames of a scene at rest.

Two things tell the noise. The difference of successive frames contains only what changes from frame to frame. The mean
of all frames contains what stays: its residual from a smooth surface. The autocovariances of both are fitted
together by white noise and by noise that neighbours share (a Gaussian window over white noise). A smooth surface that
is fitted to a window also takes away part of the shared noise; the model of the autocovariance takes away the same.
All noise is that at one distance: it is divided by its growth with the depth z, which is z^2 for stereo and a straight
line for time of flight.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Final

import numpy as np
from pydantic import ValidationError

from ..contact.membrane.frame_bias import UNKNOWN_BIAS_M
from ..contact.membrane.steps import firm_contact_bias
from ..errors import FrameError
from ..model.arrays import BoolArray, Float32Array, Float64Array, Uint16Array, spread
from ..model.clouds import valid_depth
from ..model.frames import DepthCamera, Rig, SensorFrame
from ..preset import CameraNoise, Preset, RigNoise, now
from ..sources.base import CameraRole, Progress, part_of
from .bias import MeasuredBias, describe_bias, pressed_bias, print_bias
from .untouched import TILE_PX, tile_medians

#: Usual number of frames, and fewest different ones.
NOISE_FRAMES: Final = 60
MIN_FRAMES: Final = 10
#: Lags of the autocovariances, and candidates for the correlation length, pixels.
_LAGS: Final = (0, 1, 2, 3, 4, 6, 8, 12, 16, 24, 32)
_LENGTHS_PX: Final = np.geomspace(0.8, 64.0, 60)
#: Side of the windows with a smooth surface, pixels: the first, or this multiple of the correlation length if that is
#: larger, up to the third; in small images smaller, down to the last.
_TILE_PX, _TILE_LENGTHS, _MAX_TILE_PX, _LEAST_TILE_PX = 48, 6.0, 144, 4
#: Share of a window's pixels that need a depth, and share of the frames in which a pixel needs one.
_MIN_FILLED, _MIN_SEEN = 0.85, 0.8
#: What changes and what stays have correlation lengths within this factor.
_LENGTH_RANGE: Final = 1.3
#: Smallest share of the image with depth.
_MIN_USABLE: Final = 0.01
#: Pixels whose noise is larger than the median by this factor are flying pixels at edges.
_FLYING: Final = 2.5
#: Residuals beyond this number of robust standard deviations are outliers.
_TRIM: Final = 5.0
#: Standard error of an autocovariance as a share of the variance, at the least; a correlated part below the second
#: share of the variance has no measurable length.
_MIN_ERROR, _MIN_CORRELATED = 0.005, 0.01
#: Movement: the median depth of an image tile differs by more than this share, and by more than a number of standard
#: errors, in more than this share of the tiles, between these parts of the time; frames of each part.
_MOVED_SHARE, _MOVED_SIGMAS, _MOVED_TILES, _PARTS, _PART_FRAMES = 0.0067, 5.0, 0.03, 4, 8
#: Fast movement looks like noise. No sensor of the simulator makes the median depth of a tile vary from frame to frame
#: by half of this share of the depth (standard deviation), except at edges.
_RESTLESS_SHARE: Final = 0.01
#: Fewest pixels at the membrane's distance from which the proximity noise there is taken, and the range of distances.
_NEAR_PIXELS, _NEAR_SHARE = 1500, 0.25


def measure_noise(
    frames: Sequence[SensorFrame],
    rig: Rig,
    preset: Preset,
    untouched: SensorFrame | None = None,
    progress: Progress | None = None,
) -> RigNoise:
    """Measure the noise of both cameras and the bias between them.

    Parameters
    ----------
    frames : sequence of SensorFrame
        At least 10 different frames of a scene at rest, 60 for an accurate result. Of others as many as are at rest at
        their beginning, in steps of a third. Depth images are uint16, (H, W), raw counts, at least 64 x 64 pixels.
    rig : Rig
    preset : Preset
        Its alignment relates both depths; its mask shows the prints that both cameras see.
    untouched : SensorFrame, optional
        The untouched frame, where all prints are visible.
    progress : callable, optional
        Called with the finished share, 0 to 1, and a description.

    Returns
    -------
    RigNoise
        For each camera the standard deviations of white and of correlated noise (metres, at ``distance_m``), the
        correlation length (pixels) and the share that changes from frame to frame; proximity minus tactile depth on
        the same surface (metres) with its standard deviation. ``preset.with_value("noise", noise)`` stores it.

    Raises
    ------
    FrameError
        There are too few different frames, the scene moves, or a camera sees too little depth or no smooth surface.
    RigMismatchError
        Neither preset nor rig has the pose between the cameras.
    """
    report = progress or (lambda share, words: None)
    different = list({frame.sequence: frame for frame in frames}.values())
    if len(different) < MIN_FRAMES:
        raise FrameError(f"the noise needs {MIN_FRAMES} different frames at rest, there are {len(different)}; play on")
    for frame in (*different, *([untouched] if untouched is not None else [])):
        frame.check_against(rig)
    report(0.0, "Looking for movement")
    different = _at_rest(different, rig)
    proximity, tactile = depth_noises(different, rig, lambda share, words: report(0.1 + 0.7 * share, words))
    report(0.8, "Measuring the bias")
    noise = RigNoise(proximity=proximity, tactile=tactile, measured=now(), frames=len(different))
    some = list(different[:: max(len(different) // 10, 1)])  # over the whole time
    noise = with_bias(noise, some, rig, preset, untouched)
    report(1.0, "The noise is measured")
    return noise


def with_bias(
    noise: RigNoise,
    frames: Sequence[SensorFrame],
    rig: Rig,
    preset: Preset,
    untouched: SensorFrame | None,
) -> RigNoise:
    """Return the noise of a rig with the bias that frames tell, on prints or in firm contact; unknown without these."""
    found: list[MeasuredBias | None] = []
    if rig.has_proximity:
        density_m4 = noise.proximity.density_m4(rig.proximity.intrinsics.fx)
        density_m4 += noise.tactile.density_m4(rig.tactile.intrinsics.fx)
        found = [
            print_bias(frames if untouched is None else [untouched, *frames], rig, preset, density_m4),
            pressed_bias(map(firm_contact_bias(preset, rig), frames), density_m4),
        ]
    known = [bias for bias in found if bias is not None] or [MeasuredBias(0.0, UNKNOWN_BIAS_M, "unknown")]
    bias = min(known, key=lambda bias: bias.sigma_m)
    values = {"bias_m": bias.bias_m, "bias_sigma_m": bias.sigma_m, "bias_from": bias.origin, "bias_per_m": bias.per_m}
    return noise.model_copy(update=values)


def describe(noise: RigNoise) -> list[str]:
    """Return the result in sentences: tactile noise, proximity noise, bias; without a second camera the first."""
    if noise.proximity == noise.tactile:  # the stand-in for a camera that is not there has the same noise
        return [_describe_camera("Tactile", noise.tactile)]
    return [
        _describe_camera("Tactile", noise.tactile),
        _describe_camera("Proximity", noise.proximity),
        describe_bias(MeasuredBias(noise.bias_m, noise.bias_sigma_m, noise.bias_from, noise.bias_per_m)),
    ]


def depth_noises(frames: Sequence[SensorFrame], rig: Rig, progress: Progress) -> tuple[CameraNoise, CameraNoise]:
    """Measure the noise of both cameras on two or more frames at rest; `FrameError` if they see too little."""
    images = [frame.tactile_depth for frame in frames]
    tactile = _camera_noise("tactile", images, rig.tactile, None, part_of(progress, 0, 2))
    if not rig.has_proximity:
        return tactile, tactile
    images = [frame.proximity_depth for frame in frames]
    return _camera_noise("proximity", images, rig.proximity, tactile.distance_m, part_of(progress, 1, 2)), tactile


#: Autocovariances at `_LAGS` and their standard errors, m^2.
Autocovariances = tuple[Float64Array, Float64Array]


def _camera_noise(
    role: CameraRole, images: Sequence[Uint16Array], camera: DepthCamera, membrane_m: float | None, progress: Progress
) -> CameraNoise:
    """Measure one camera; ``membrane_m`` is the membrane's distance for a time-of-flight camera, None for stereo."""
    depths = _metres(images, camera)
    count, added = np.isfinite(depths).sum(axis=0), np.zeros(images[0].shape)
    for depth in depths:  # one at a time: a copy of 300 frames takes too much memory
        added += np.nan_to_num(depth)
    with np.errstate(invalid="ignore"):
        mean = np.asarray(added / count, np.float32)
    seen = count >= _MIN_SEEN * len(depths)
    if seen.mean() < _MIN_USABLE:
        raise FrameError(f"the {role} camera sees depth in only {100 * seen.mean():.1f} % of its image; check its view")
    squares, pairs = (np.zeros(depths.shape[1:], np.float32) for _ in range(2))
    for before, after in pairwise(depths):
        difference = after - before
        known = np.isfinite(difference)
        squares += np.where(known, difference, 0) ** 2
        pairs += known
    deviation = np.asarray(np.sqrt(squares / np.maximum(2 * pairs, 1)), np.float32)
    if membrane_m is None:
        distance_m = float(np.median(mean[seen]))
        growth = np.asarray((mean / distance_m) ** 2, np.float32)
        surface, divisor = distance_m - distance_m**2 / mean, np.ones_like(growth)  # a disparity's noise is the same
    else:
        near = seen & (np.abs(mean - membrane_m) < _NEAR_SHARE * membrane_m)
        distance_m = membrane_m if near.sum() >= _NEAR_PIXELS else float(np.median(mean[seen]))
        growth = _growth(mean, deviation, seen, distance_m)
        surface, divisor = mean, growth
    at_distance = deviation / growth
    good = seen & (at_distance <= _FLYING * max(float(np.median(at_distance[seen])), camera.depth_unit_m / 4))

    # What changes tells the length first: the windows over which surfaces are fitted must be larger.
    words = f"Measuring the {role} noise"
    smooth = np.where(good, growth, np.float32(np.nan))
    least_m = camera.depth_unit_m / 2
    changing = _changing_autocovariances(depths, smooth, least_m, lambda share: progress(share, words))
    (white_changing, shared_changing, *_), length_px = _fit_noise(changing)
    if shared_changing <= _MIN_CORRELATED * (white_changing + shared_changing):
        length_px = 0.0
    fixed, tile_px = _fixed_autocovariances(role, surface, divisor, good, length_px)
    # Where only what stays is correlated, shape is not told from lengths beyond a share of the window.
    lengths = (length_px / _LENGTH_RANGE, length_px * _LENGTH_RANGE) if length_px else (0.0, tile_px / _TILE_LENGTHS)
    parts, length_px = _fit_noise(changing, fixed, tile_px, len(depths), lengths)
    white_changing, shared_changing, white_fixed, shared_fixed = parts
    total, shared = sum(parts), shared_changing + shared_fixed
    if shared <= _MIN_CORRELATED * total:
        length_px = 0.0
    try:
        return CameraNoise(
            white_m=float(np.sqrt(white_changing + white_fixed)),
            correlated_m=float(np.sqrt(shared)) if length_px else 0.0,
            length_px=length_px,
            changing_share=(white_changing + shared_changing) / total if total > 0 else 0.0,
            distance_m=distance_m,
        )
    except ValidationError as error:
        raise FrameError(
            f"a depth of {distance_m:.3g} m with a noise of {math.sqrt(total):.2g} m, as the {role} camera gives, is "
            f"none of such a sensor; check the camera's depth unit, {camera.depth_unit_m:g} m"
        ) from error


def _metres(images: Sequence[Uint16Array], camera: DepthCamera) -> Float32Array:
    """Return depths in metres, shape (N, H, W), nan where there is none."""
    depths = np.empty((len(images), *images[0].shape), np.float32)
    for depth, counts in zip(depths, images, strict=True):
        np.multiply(counts, np.float32(camera.depth_unit_m), out=depth)
        depth[~valid_depth(counts)] = np.nan
    return depths


def _growth(mean: Float32Array, deviation: Float32Array, seen: BoolArray, distance_m: float) -> Float32Array:
    """Return each pixel's noise as a multiple of that at a distance, by a straight line over the depth."""
    parts = np.array_split(np.argsort(mean[seen]), min(12, int(seen.sum())))
    depth, noise = (np.array([np.median(image[seen][part]) for part in parts]) for image in (mean, deviation))
    slope, start = np.polyfit(depth, noise, 1) if np.ptp(depth) >= 0.2 * distance_m else (0.0, 1.0)
    there = start + slope * distance_m
    if there <= 0:
        return np.ones_like(mean)
    return np.asarray(np.clip((start + slope * mean) / there, 0.2, 20.0), np.float32)


def _changing_autocovariances(
    depths: Float32Array, growth: Float32Array, least_m: float, report: Callable[[float], None]
) -> Autocovariances:
    """Return the autocovariances of the part that changes; ``growth`` is nan where pixels are left out.

    Of coarse depth most differences are 0: those of a count are no outliers, so ``least_m`` is the least spread.
    """
    rows = []
    for number, (before, after) in enumerate(pairwise(depths)):
        report(number / len(depths))
        noise = (after - before) / growth
        if not np.isfinite(noise).any():
            continue  # a frame without depth
        noise -= np.nanmedian(noise)
        limit = _TRIM * max(spread(noise), least_m)
        rows.append(_autocovariances(np.where(np.abs(noise) <= limit, noise, np.nan)) / 2)
    return _with_errors(np.asarray(rows))


def _autocovariances(image: Float32Array) -> Float64Array:
    """Return the mean products of pixels at `_LAGS` along rows and columns; nan where there is no pair."""
    known = np.isfinite(image)
    filled, weight = np.where(known, image, np.float32(0)), known.astype(np.float32)
    values = []
    for lag in _LAGS:
        pairs, products = 0.0, 0.0
        for first, second in ((np.s_[:, lag:], np.s_[:, : -lag or None]), (np.s_[lag:], np.s_[: -lag or None])):
            pairs += float(np.vdot(weight[first], weight[second]))
            products += float(np.vdot(filled[first], filled[second]))
        values.append(products / pairs if pairs else np.nan)
    return np.array(values)


def _with_errors(rows: Float64Array) -> Autocovariances:
    """Average autocovariances, shape (M, lags), of M samples."""
    counts = np.isfinite(rows).sum(axis=0)
    with np.errstate(invalid="ignore"):
        values = np.nansum(rows, axis=0) / counts  # nan where there is none
        errors = np.sqrt(np.nansum((rows - values) ** 2, axis=0) / counts) / np.sqrt(np.maximum(counts, 1))
    return values, np.maximum(errors, _MIN_ERROR * abs(values[0]))


def _fixed_autocovariances(
    role: CameraRole, surface: Float32Array, divisor: Float32Array, good: BoolArray, length_px: float
) -> tuple[Autocovariances, int]:
    """Return the autocovariances of the mean frame's residuals from smooth surfaces, and the window size, pixels."""
    largest = max(min(_MAX_TILE_PX, min(surface.shape) // 3), _LEAST_TILE_PX)
    for tile_px in (int(np.clip(_TILE_LENGTHS * length_px, _TILE_PX, largest)), min(_TILE_PX, largest)):
        rows = _residual_autocovariances(surface, divisor, good, tile_px)
        if len(rows):
            return _with_errors(rows), tile_px
    raise FrameError(f"the {role} camera sees no smooth surface; put a smooth object or a wall in front of it")


def _residual_autocovariances(
    surface: Float32Array, divisor: Float32Array, good: BoolArray, tile_px: int
) -> Float64Array:
    """Return the autocovariances of a quadratic's residual, a row for each of the smoothest half of the windows."""
    basis = _quadratics(tile_px).reshape(-1, 6)
    windows = []
    step = tile_px // 2
    for top in range(0, surface.shape[0] - tile_px + 1, step):
        for left in range(0, surface.shape[1] - tile_px + 1, step):
            place = np.s_[top : top + tile_px, left : left + tile_px]
            known = good[place].reshape(-1)
            if known.mean() < _MIN_FILLED:
                continue
            values = surface[place].reshape(-1).astype(np.float64)
            for _ in range(2):
                used = basis[known]
                weights = np.linalg.solve(used.T @ used, used.T @ values[known])
                residual = values - basis @ weights
                known = known & (np.abs(residual) <= _TRIM * spread(residual[known]) + 1e-9)
            residual = np.where(known, residual, np.nan) / divisor[place].reshape(-1)
            windows.append((float(np.linalg.norm(weights[3:])), residual.reshape(tile_px, tile_px)))
    windows.sort(key=lambda window: window[0])
    smoothest = [residual for _, residual in windows[: (len(windows) + 1) // 2]]
    variances = np.array([np.nanvar(residual) for residual in smoothest])
    kept = variances <= 6 * np.median(variances) if len(variances) else []
    return np.array(
        [_autocovariances(residual.astype(np.float32)) for residual, keep in zip(smoothest, kept, strict=True) if keep]
    )


def _fit_noise(
    changing: Autocovariances,
    fixed: Autocovariances | None = None,
    tile_px: int = 0,
    frames: int = 1,
    lengths_px: tuple[float, float] = (0.0, np.inf),
) -> tuple[Float64Array, float]:
    """Return the variances, m^2, of white and correlated noise that changes, then that stays, and the length, px."""
    from scipy.optimize import nnls  # slow to import

    best: tuple[float, Float64Array, float] = (np.inf, np.zeros(4), 0.0)
    values, errors = changing if fixed is None else (np.concatenate(both) for both in zip(changing, fixed, strict=True))
    used = np.isfinite(values) & (errors > 0)
    if not used.any():
        return best[1], 0.0
    lags = np.array(_LAGS, np.float64)
    for length_px in _LENGTHS_PX[(lengths_px[0] <= _LENGTHS_PX) & (lengths_px[1] >= _LENGTHS_PX)]:
        white, shared = (lags == 0).astype(float), np.exp(-(lags**2) / (4 * length_px**2))
        model = np.column_stack([white, shared, np.zeros((len(lags), 2))])
        if fixed:
            stays = np.column_stack([_seen_covariances(0.0, tile_px), _seen_covariances(float(length_px), tile_px)])
            model = np.vstack([model, np.column_stack([stays / frames, stays])])
        parts, misfit = nnls(model[used] / errors[used, None], values[used] / errors[used])
        if misfit < best[0]:
            best = (misfit, parts, float(length_px))
    return best[1], best[2]


@lru_cache(maxsize=256)
def _seen_covariances(length_px: float, tile_px: int) -> Float64Array:
    """Return the autocovariances at `_LAGS` of noise of variance 1 after a quadratic surface is fitted and subtracted.

    With the noise's covariance C and the projector Q Q' onto the surfaces the residual has the covariance

        (I - Q Q') C (I - Q Q') = C - (Q (CQ)' + CQ Q' - Q (Q'CQ) Q')

    C is that of rows times that of columns, so CQ needs no matrix of all pairs of pixels. A lag is a shift along a row:
    the mean of the bracket over all pixels is what the fit takes away. Length 0 is white noise.
    """
    basis = _quadratics(tile_px)  # Q as six images
    places = np.arange(tile_px)
    of_line = np.eye(tile_px)
    if length_px > 0:
        of_line = np.exp(-((places[:, None] - places) ** 2) / (4 * length_px**2))
    c_q = np.einsum("ia,abk,bj->ijk", of_line, basis, of_line, optimize=True)
    second_terms = basis @ np.einsum("ijk,ijl->kl", basis, c_q) - c_q
    values = []
    for lag in _LAGS:
        if lag >= tile_px:
            values.append(0.0)
            continue
        left, right = np.s_[:, : tile_px - lag], np.s_[:, lag:]
        lost = np.sum(basis[left] * c_q[right] - second_terms[left] * basis[right]) / c_q[left][..., 0].size
        values.append(of_line[0, lag] - lost)
    return np.array(values)


@lru_cache(maxsize=16)
def _quadratics(tile_px: int) -> Float64Array:
    """Return orthonormal images of the six quadratic surfaces, shape (T, T, 6), the curved ones last."""
    y, x = np.mgrid[-1 : 1 : 1j * tile_px, -1 : 1 : 1j * tile_px]
    columns = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=2).reshape(-1, 6)
    return np.linalg.qr(columns)[0].reshape(tile_px, tile_px, 6)


def _at_rest(frames: list[SensorFrame], rig: Rig) -> list[SensorFrame]:
    """Return the frames, or fewer of their beginning: in a recording a press follows; raise if these move, too."""
    try:
        _refuse_movement("tactile", [frame.tactile_depth for frame in frames], rig.tactile)
        if rig.has_proximity:
            _refuse_movement("proximity", [frame.proximity_depth for frame in frames], rig.proximity)
    except FrameError:
        if len(frames) == MIN_FRAMES:
            raise
        return _at_rest(frames[: max(2 * len(frames) // 3, MIN_FRAMES)], rig)
    return frames


def _refuse_movement(role: CameraRole, images: Sequence[Uint16Array], camera: DepthCamera) -> None:
    """Raise if the depth differs between the images by more than noise."""
    some = images[:: max(len(images) // (_PARTS * _PART_FRAMES), 1)]
    medians = np.array([tile_medians(image) for image in some])
    parts, steps = np.array_split(medians, _PARTS), np.diff(medians, axis=0)
    seen = np.all([np.isfinite(part).any(axis=0) for part in (*parts, steps)], axis=0)
    if not seen.any():
        return  # the lack of depth is reported later
    resting = np.array([np.nanmedian(part[:, seen], axis=0) for part in parts])
    depth, change = resting.mean(axis=0), np.ptp(resting, axis=0)
    deviation = np.sqrt(np.nanmean(steps[:, seen] ** 2, axis=0) / 2)  # from frame to frame, without slow movement
    error = 1.25 * deviation / np.sqrt(len(some) / _PARTS)  # of a median
    moved = change > np.maximum(_MOVED_SHARE * depth, _MOVED_SIGMAS * error)
    share = max(moved.mean(), (deviation > _RESTLESS_SHARE * depth).mean())
    if share > _MOVED_TILES:
        most = np.maximum(change, deviation)
        row, column = divmod(int(np.flatnonzero(seen)[most.argmax()]), camera.intrinsics.width // TILE_PX)
        raise FrameError(
            f"the scene moves: the {role} depth changes in {100 * share:.0f} % of the image, most "
            f"by {1e3 * camera.depth_unit_m * most.max():.0f} mm near pixel "
            f"({TILE_PX * column + TILE_PX // 2}, {TILE_PX * row + TILE_PX // 2}); "
            "hold everything still and measure again"
        )


def _describe_camera(name: str, noise: CameraNoise) -> str:
    parts = "from pixel to pixel"
    if noise.correlated_m > noise.white_m / 10:
        white_mm, shared_mm = 1e3 * noise.white_m, 1e3 * noise.correlated_m
        parts = f"{shared_mm:.2f} mm over {noise.length_px:.0f} px, {white_mm:.2f} mm from pixel to pixel"
    return (
        f"{name} noise {1e3 * noise.total_m:.2f} mm at {1e3 * noise.distance_m:.0f} mm distance ({parts}); "
        f"{100 * noise.changing_share:.0f} % of its variance changes from frame to frame."
    )
