import numpy as np
import pytest

from tactune.core.model.intrinsics import Intrinsics
from tactune.widgets.basics.colormaps import depth_lut
from tactune.widgets.clouds.cloud_data import DepthCloud, free_cloud
from tactune.widgets.clouds.view_camera import ViewCamera

LENS = Intrinsics(width=5, height=4, fx=6.0, fy=7.0, cx=2.0, cy=1.5)
RAYS = LENS.rays()
EYE = np.eye(4)


def cloud_of(depth, **changes):
    given = {"depth_unit_m": 0.001, "rays": RAYS, "lut": depth_lut(), "pose": EYE} | changes
    return DepthCloud(np.asarray(depth, dtype=np.uint16), **given)


def test_points_are_pose_times_ray_times_corrected_depth():
    depth = np.zeros((4, 5), np.uint16)
    depth[1, 3], depth[3, 0] = 500, 800
    pose = np.array([[0.0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]])
    points = cloud_of(depth, pose=pose, depth_scale=2.0, depth_offset_m=-0.1).points()
    expected = []
    for u, v, z in ((3, 1, 0.9), (0, 3, 1.5)):
        x, y = (u - 2.0) / 6.0 * z, (v - 1.5) / 7.0 * z
        expected.append((-y + 0.1, x + 0.2, z + 0.3))
    np.testing.assert_allclose(points, expected, atol=1e-6)


def test_no_depth_hidden_colours_and_depths_that_are_not_positive_do_not_count():
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


# The camera


@pytest.mark.parametrize("size", [(400, 300), (200, 600)])
@pytest.mark.parametrize("viewpoint", ["reset", "top", "side"])
def test_framing_fills_the_view_without_cutting(size, viewpoint):
    rng = np.random.default_rng(2)
    points = rng.uniform(-1, 1, (4000, 3)) * (0.18, 0.1, 0.04) + (0.03, 0, 0.27)
    camera = ViewCamera().looking_from(viewpoint).framing(points, *size)
    pixels = camera.project(points, *size)[:, :2] / size
    inside = ((pixels >= 0) & (pixels <= 1)).all(axis=1)
    assert inside.mean() > 0.98
    assert np.ptp(pixels, axis=0).max() > 0.85
    assert np.abs(pixels.min(axis=0) + pixels.max(axis=0) - 1).max() < 0.1, "centred"


def test_free_points_survive_the_image():
    rng = np.random.default_rng(4)
    points = rng.uniform(-0.15, 0.15, (5000, 3)) + np.array([0.3, -0.1, 0.0])
    cloud = free_cloud(points, np.zeros(5000, np.uint8), depth_lut())
    np.testing.assert_allclose(cloud.points(), points, atol=3e-6)
