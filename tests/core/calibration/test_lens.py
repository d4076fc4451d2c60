"""Lenses from pictures of a chessboard, and nominal ones: what is fitted, and what is refused."""

import shutil

import cv2
import numpy as np
import pytest

from tactune.core.calibration.folder_rig import check_lens, fit_lens
from tactune.core.errors import CalibrationError
from tactune.core.model.intrinsics import Distortion, Intrinsics

LENS = Intrinsics(
    width=640,
    height=480,
    fx=610.0,
    fy=605.0,
    cx=310.0,
    cy=250.0,
    distortion=Distortion.BROWN_CONRADY,
    coefficients=(-0.1, 0.05, 0.001, -0.001, 0.0),
)
TILTS_DEG = ((0, 0), (25, 0), (-25, 5), (0, 25), (5, -25), (20, 20))


def draw_boards(folder, tilts, lens=LENS):
    """Draw a board of 8 x 6 inner corners at these tilts, as the lens sees it."""
    v, u = np.mgrid[: lens.height, : lens.width]
    rays = np.column_stack([lens.normalise(np.column_stack([u.ravel(), v.ravel()])), np.ones(u.size)])
    for number, (about_x, about_y) in enumerate(tilts):
        R = cv2.Rodrigues(np.radians([about_x, about_y, 3.0 * number]))[0]
        centre = np.array([0.01 * number - 0.02, 0.01, 0.42])
        depth = (R[:, 2] @ centre) / (rays @ R[:, 2])
        board = (rays * depth[:, None] - centre) @ R / 0.03 + (4.5, 3.5, 0.0)
        square = np.floor(board[:, :2]).astype(int)
        inside = ((square >= 0) & (square < (9, 7))).all(axis=1)
        dark = inside & (square.sum(axis=1) % 2 == 0)
        image = cv2.GaussianBlur(np.where(dark, 40, 220).astype(np.uint8).reshape(v.shape), (0, 0), 0.7)
        cv2.imwrite(str(folder / f"{number}.png"), image)


def test_the_lens_that_drew_the_boards_is_found(tmp_path):
    draw_boards(tmp_path, TILTS_DEG)
    fit = fit_lens(tmp_path, 8, 6, (640, 480))
    assert fit.used == len(TILTS_DEG)
    assert fit.rms_px < 0.3
    assert (fit.intrinsics.fx, fit.intrinsics.fy) == pytest.approx((610.0, 605.0), abs=5.0)
    assert (fit.intrinsics.cx, fit.intrinsics.cy) == pytest.approx((310.0, 250.0), abs=8.0)
    assert fit.intrinsics.coefficients[0] == pytest.approx(-0.1, abs=0.03)


def test_a_real_camera_agrees_with_opencvs_own_calibration(tmp_path, shared_data):
    for path in (shared_data / "stereo_boards").glob("left*.jpg"):
        shutil.copy(path, tmp_path)
    fit = fit_lens(tmp_path, 9, 6)
    assert fit.intrinsics.fx == pytest.approx(535.9, rel=0.01)  # left_intrinsics.yml, from 13 pictures
    assert fit.rms_px == pytest.approx(0.19, abs=0.02)


@pytest.mark.parametrize("tilts", [[(0, 0)] * 5, [(25, 10)] * 4, [(0, 0)] * 4 + [(8, 0)]])
def test_boards_that_tell_no_focal_length_are_refused_with_the_remedy(tmp_path, tilts):
    draw_boards(tmp_path, tilts)
    with pytest.raises(CalibrationError, match=r"do not tell focal length .* tilt the board"):
        fit_lens(tmp_path, 8, 6)


def test_the_stated_deviation_is_that_of_fits_to_other_noise(tmp_path):
    draw_boards(tmp_path, TILTS_DEG)
    clean = {path: cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in tmp_path.iterdir()}
    rng, fits = np.random.default_rng(0), []
    for _ in range(8):
        for path, image in clean.items():
            cv2.imwrite(str(path), np.clip(image + rng.normal(0, 12, image.shape), 0, 255).astype(np.uint8))
        fits.append(fit_lens(tmp_path, 8, 6))
    observed = max(np.std([getattr(fit.intrinsics, axis) for fit in fits]) for axis in ("fx", "fy"))
    assert 0.5 < np.mean([fit.focal_sd_px for fit in fits]) / observed < 3


def test_too_few_pictures_and_other_sizes_are_said(tmp_path):
    with pytest.raises(CalibrationError, match="in 0 of 0 pictures, but 4 are needed"):
        fit_lens(tmp_path, 8, 6)
    draw_boards(tmp_path, TILTS_DEG)
    with pytest.raises(CalibrationError, match="it has 640 x 480 pixels, but 1280 x 720 are needed"):
        fit_lens(tmp_path, 8, 6, (1280, 720))
    with pytest.raises(CalibrationError, match="cannot list"):
        fit_lens(tmp_path / "nowhere", 8, 6)


def test_no_camera_has_such_a_lens():
    with pytest.raises(CalibrationError, match="fx is 9 px, a view of 177 degrees"):
        check_lens(LENS.model_copy(update={"fx": 9.0}), "tactile camera")
