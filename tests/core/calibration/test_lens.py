"""Lenses from pictures of a chessboard, and nominal ones; boards and droplets found in images."""

import shutil

import cv2
import numpy as np
import pytest

from tactune.core.calibration.detect import detect_chessboard, snap_to_feature
from tactune.core.calibration.rig_from_folder import check_lens, fit_lens
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
    with pytest.raises(CalibrationError, match=r"fx is uncertain by .* tilt the board"):
        fit_lens(tmp_path, 8, 6)


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


H = np.array([[0.95, 0.06, 20], [-0.05, 0.92, 40], [1e-4, 5e-5, 1]])
TILT = np.array([[0.9, -0.04, 60], [0.06, 0.95, 10], [-8e-5, 1e-4, 1]])


def seen(picture, H):
    return cv2.warpPerspective(picture, H, (640, 480), flags=cv2.INTER_AREA, borderValue=255)


def mapped(H, points):
    return cv2.perspectiveTransform(np.asarray(points, np.float64).reshape(-1, 1, 2), H).reshape(-1, 2)


def chessboard():
    squares = np.indices((7, 10)).sum(axis=0) % 2 * 220 + 20
    picture = np.full((480, 640), 255, np.uint8)
    picture[30:450, 20:620] = np.kron(squares, np.ones((60, 60)))
    corners = np.stack(np.meshgrid(20 + 60 * np.arange(1, 10), 30 + 60 * np.arange(1, 7)), axis=-1).reshape(-1, 2) - 0.5
    return picture, corners


def test_a_chessboard_is_found_in_the_same_order_by_both_cameras():
    picture, corners = chessboard()
    for view in (H, TILT):
        found = detect_chessboard(seen(picture, view), 9, 6)
        assert np.hypot(*(found - mapped(view, corners)).T).max() < 0.25
        turned = detect_chessboard(np.ascontiguousarray(np.rot90(seen(picture, view), 2)), 9, 6)
        assert turned[0].sum() < turned[-1].sum()


def test_what_is_not_there_is_refused_in_words():
    nothing = np.full((480, 640, 3), 128, np.uint8)
    for size, words in (((9, 6), "no chessboard of 9 x 6"), ((2, 9), "too small")):
        with pytest.raises(CalibrationError, match=words):
            detect_chessboard(nothing, *size)


@pytest.mark.parametrize("bright", [False, True])
def test_a_click_beside_a_droplet_snaps_to_its_centre(bright):
    rng = np.random.default_rng(0)
    big = np.zeros((800, 800), np.uint8)
    center = (403, 391)
    cv2.ellipse(big, center, (30, 22), 30, 0, 360, 255, -1)
    ink = cv2.resize(big, (100, 100), interpolation=cv2.INTER_AREA).astype(float) / 255
    true = (np.array(center) + 0.5) / 8 - 0.5
    image = (60 + 120 * ink if bright else 180 - 120 * ink) + 2 * rng.standard_normal(ink.shape)
    image = image.astype(np.uint8)
    for angle in np.linspace(0, 6, 9):
        click = true + 5.5 * np.array([np.cos(angle), np.sin(angle)])
        snapped = snap_to_feature(image, *click)
        assert snapped.kind == "blob"
        assert np.hypot(snapped.u - true[0], snapped.v - true[1]) < 0.12


def test_beside_dots_and_on_bare_membrane_nothing_snaps_but_a_clicked_dot_does():
    rng = np.random.default_rng(0)
    image = 150 + 4 * rng.standard_normal((240, 320))
    places = [(40 + 40 * column, 40 + 40 * row) for row in range(5) for column in range(7)]
    for place in places:
        cv2.circle(image, place, 9, 50.0, -1, cv2.LINE_AA)
    image = cv2.GaussianBlur(image, (0, 0), 0.8).clip(0, 255).astype(np.uint8)
    for place in places:
        angle = rng.uniform(0, 2 * np.pi)
        for distance in (7.5, 11.0, 14.0, 20.0):
            found = snap_to_feature(image, *(place + distance * np.array([np.cos(angle), np.sin(angle)])))
            if distance < 9:  # the dot itself was clicked, although its centre is beyond reach
                assert np.hypot(found.u - place[0], found.v - place[1]) < 0.2
            else:
                assert found is None, f"{distance} px from a dot of 9 px"


@pytest.mark.parametrize("number", [1, 5])
def test_real_boards_as_well_as_opencv(number, shared_data):
    files = [shared_data / "stereo_boards" / f"{side}0{number}.jpg" for side in ("left", "right")]
    left, right = (cv2.imread(str(file), cv2.IMREAD_GRAYSCALE) for file in files)
    a, b = detect_chessboard(left, 9, 6), detect_chessboard(right, 9, 6)
    refined, _ = cv2.findHomography(a, b, 0)
    assert np.sqrt(np.mean(np.sum((mapped(refined, a) - b) ** 2, axis=1))) < 3.0
    rng = np.random.default_rng(number)
    for u, v in a:
        angle, radius = rng.uniform(0, 2 * np.pi), 6 * np.sqrt(rng.uniform())
        snapped = snap_to_feature(left, u + radius * np.cos(angle), v + radius * np.sin(angle))
        assert snapped.kind == "crossing"
        assert np.hypot(snapped.u - u, snapped.v - v) < 0.1
