from __future__ import annotations

from math import pi

import numpy as np
import numpy.typing as npt
import pytest

from tactune.core.errors import FrameError
from tactune.core.model.intrinsics import Intrinsics
from tactune.widgets.basics.colormaps import depth_lut
from tactune.widgets.clouds.cloud_data import DepthCloud
from tactune.widgets.clouds.view_camera import ViewCamera

LENS = Intrinsics(width=5, height=4, fx=6.0, fy=7.0, cx=2.0, cy=1.5)
RAYS = LENS.rays()
EYE = np.eye(4)


def cloud_of(depth: npt.ArrayLike, **changes: object) -> DepthCloud:
    given: dict[str, object] = {"depth_unit_m": 0.001, "rays": RAYS, "lut": depth_lut(), "pose": EYE} | changes
    return DepthCloud(np.asarray(depth, dtype=np.uint16), **given)  # type: ignore[arg-type]


def test_points_are_pose_times_ray_times_corrected_depth() -> None:
    depth = np.zeros((4, 5), np.uint16)
    depth[1, 3], depth[3, 0] = 500, 800
    pose = np.array([[0.0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]])
    points = cloud_of(depth, pose=pose, depth_scale=2.0, depth_offset_m=-0.1).points()
    expected = []
    for u, v, z in ((3, 1, 0.9), (0, 3, 1.5)):
        x, y = (u - 2.0) / 6.0 * z, (v - 1.5) / 7.0 * z
        expected.append((-y + 0.1, x + 0.2, z + 0.3))
    np.testing.assert_allclose(points, expected, atol=1e-6)


def test_no_depth_hidden_colours_and_depths_that_are_not_positive_do_not_count() -> None:
    depth = np.full((4, 5), 100, np.uint16)
    depth[0] = (0, 65535, 65534, 1, 50)
    index = np.ones((4, 5), np.uint8)
    index[1, 2] = 7
    lut = np.full((256, 4), 255, np.uint8)
    assert cloud_of(depth).point_count == 18
    lut[7, 3] = 0
    assert cloud_of(depth, index=index, lut=lut).point_count == 17
    assert cloud_of(depth, depth_offset_m=-0.05).point_count == 16, "at 1 and 50 counts nothing positive is left"
    assert cloud_of(depth, count=3).point_count == 3


def test_without_an_index_the_depth_chooses_the_colour() -> None:
    depth = np.full((4, 5), 300, np.uint16)
    depth[0] = (200, 100, 400, 900, 250)
    rows = cloud_of(depth, depth_range_m=(0.2, 0.4)).rows()
    assert rows[0].tolist() == [0, 0, 255, 255, 64]
    assert rows[1, 0] in (127, 128)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"rays": RAYS[:3]}, "rays must be a float32 array of 4 x 5 x 2"),
        ({"rays": RAYS.astype(np.float64)}, "rays must be a float32 array"),
        ({"lut": np.zeros((255, 4), np.uint8)}, "lut must be a uint8 array of 256 x 4"),
        ({"index": np.zeros((5, 4), np.uint8)}, "index must be a uint8 array of 4 x 5"),
        ({"pose": np.eye(3)}, "pose must be a float64 array of 4 x 4"),
        ({"depth_range_m": (0.4, 0.4)}, "depth_range_m must go from near to far"),
    ],
)
def test_wrong_arrays_are_refused_by_name(change: dict[str, object], words: str) -> None:
    with pytest.raises(FrameError, match=words):
        cloud_of(np.zeros((4, 5)), **change)


# The camera


def look_at_projection(camera: ViewCamera, point: npt.ArrayLike, width: int, height: int) -> npt.NDArray[np.float64]:
    """Project by the definition of a pinhole camera, from the camera's place and a world 'up' only."""
    back = np.array(
        [
            np.sin(camera.azimuth) * np.cos(camera.elevation),
            -np.sin(camera.elevation),
            -np.cos(camera.azimuth) * np.cos(camera.elevation),
        ]
    )
    eye = np.array(camera.target) + camera.distance * back
    forward = -back
    right = np.cross(forward, (0.0, -1.0, 0.0))
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    offset = np.asarray(point) - eye
    focal = min(width, height) / 2 / np.tan(camera.field_of_view / 2)
    w = offset @ forward
    return np.array([width / 2 + focal * (offset @ right) / w, height / 2 - focal * (offset @ up) / w, w])


@pytest.mark.parametrize("azimuth", [-2.5, -0.4, 0.0, 1.0])
@pytest.mark.parametrize("elevation", [-1.2, 0.0, 0.5])
def test_projection_is_that_of_a_pinhole_that_looks_at_the_target(azimuth: float, elevation: float) -> None:
    camera = ViewCamera((0.02, -0.01, 0.3), 0.7, azimuth, elevation)
    points = np.random.default_rng(1).uniform(-0.1, 0.1, (20, 3)) + np.array([0, 0, 0.3])
    expected = [look_at_projection(camera, point, 400, 300) for point in points]
    np.testing.assert_allclose(camera.project(points, 400, 300), expected, atol=1e-9)
    np.testing.assert_allclose(camera.project([camera.target], 400, 300)[0], (200, 150, 0.7), atol=1e-9)


def test_image_up_is_up_from_behind_the_cameras() -> None:
    camera = ViewCamera(azimuth=0.0, elevation=0.0)
    right_of, below = camera.project([(0.05, 0, 0.25), (0, 0.05, 0.25)], 200, 200)
    assert right_of[0] > 100
    assert below[1] > 100


def test_panning_moves_the_target_by_just_these_pixels() -> None:
    camera = ViewCamera()
    moved = camera.panned(30, -12, 400, 300)
    u, v, w = moved.project([camera.target], 400, 300)[0]
    assert (u, v, w) == pytest.approx((230, 138, camera.distance))


def test_zooming_holds_the_point_under_the_cursor() -> None:
    camera = ViewCamera()
    right, up, _ = camera.axes()
    point = np.array(camera.target) + 0.04 * right - 0.03 * up
    u, v, _ = camera.project([point], 400, 300)[0]
    nearer = camera.zoomed(1.5, (u, v), 400, 300)
    assert nearer.distance == pytest.approx(camera.distance / 1.5)
    np.testing.assert_allclose(nearer.project([point], 400, 300)[0, :2], (u, v), atol=1e-9)


def test_zoom_and_elevation_stop_at_their_limits() -> None:
    camera = ViewCamera()
    for _ in range(300):
        camera = camera.zoomed(1.2, (10, 10), 400, 300).orbited(0.1, 0.2)
    assert camera.distance > 0
    assert camera.elevation == pi / 2
    assert -pi <= camera.azimuth <= pi
    assert np.isfinite(camera.pixel_matrix(400, 300)).all()


@pytest.mark.parametrize("size", [(400, 300), (200, 600)])
@pytest.mark.parametrize("viewpoint", ["reset", "top", "side"])
def test_framing_fills_the_view_without_cutting(size: tuple[int, int], viewpoint: str) -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(-1, 1, (4000, 3)) * (0.18, 0.1, 0.04) + (0.03, 0, 0.27)
    camera = ViewCamera().looking_from(viewpoint).framing(points, *size)  # type: ignore[arg-type]
    pixels = camera.project(points, *size)[:, :2] / size
    inside = ((pixels >= 0) & (pixels <= 1)).all(axis=1)
    assert inside.mean() > 0.98
    assert np.ptp(pixels, axis=0).max() > 0.85
    assert np.abs(pixels.min(axis=0) + pixels.max(axis=0) - 1).max() < 0.1, "centred"


def test_framing_does_not_chase_flying_pixels() -> None:
    points = np.random.default_rng(3).uniform(-0.1, 0.1, (2000, 3)) + np.array([0, 0, 0.3])
    flying = np.concatenate([points, [(0, 0, 9.0), (4.0, 0, 5.0)]])
    near, far = ViewCamera().framing(points, 300, 300), ViewCamera().framing(flying, 300, 300)
    assert far.distance == pytest.approx(near.distance, rel=0.05)


def test_framing_nothing_keeps_the_camera() -> None:
    camera = ViewCamera()
    assert camera.framing(np.empty((0, 3)), 300, 300) == camera
