import numpy as np
import pytest

from tactune.core.model.clouds import deproject, deproject_image, nearest_pixels, ray_table, valid_depth
from tactune.core.model.frames import DepthCamera
from tactune.core.model.intrinsics import Distortion, Intrinsics

COEFFICIENTS = (0.12, -0.22, 0.001, -0.0007, 0.08)


def camera(distortion, coefficients=COEFFICIENTS):
    return Intrinsics(
        width=640, height=480, fx=460.0, fy=461.0, cx=318.2, cy=242.7, distortion=distortion, coefficients=coefficients
    )


@pytest.fixture(scope="module")
def rs():
    return pytest.importorskip("pyrealsense2", reason="needs the extra realsense", exc_type=ImportError)


def librealsense_intrinsics(rs, lens):
    twin = rs.intrinsics()
    twin.width, twin.height = lens.width, lens.height
    twin.fx, twin.fy, twin.ppx, twin.ppy = lens.fx, lens.fy, lens.cx, lens.cy
    twin.model = getattr(rs.distortion, lens.distortion.value)
    twin.coeffs = list(lens.coefficients)
    return twin


@pytest.mark.parametrize("distortion", list(Distortion))
def test_deprojection_is_librealsenses_for_every_lens_model(rs, distortion):
    lens = camera(distortion)
    twin = librealsense_intrinsics(rs, lens)
    rng = np.random.default_rng(0)
    pixels = rng.integers([0, 0], [640, 480], (500, 2))
    depths = rng.uniform(0.1, 1.0, 500)
    theirs = np.array(
        [rs.rs2_deproject_pixel_to_point(twin, list(map(float, p)), d) for p, d in zip(pixels, depths, strict=True)]
    )
    ours = np.concatenate([lens.normalise(pixels), np.ones((500, 1))], axis=1) * depths[:, None]
    error = np.linalg.norm(ours - theirs, axis=1) / np.linalg.norm(theirs, axis=1)
    assert error.max() < 1e-6

    table = lens.rays()[pixels[:, 1], pixels[:, 0]] * depths[:, None].astype(np.float32)
    assert np.abs(table - theirs[:, :2]).max() < 1e-6


@pytest.mark.parametrize("distortion", list(Distortion))
def test_projection_is_librealsenses_for_every_lens_model(rs, distortion):
    lens = camera(distortion)
    twin = librealsense_intrinsics(rs, lens)
    rng = np.random.default_rng(1)
    points = np.concatenate([rng.uniform(-0.1, 0.1, (200, 2)), rng.uniform(0.2, 0.5, (200, 1))], axis=1)
    theirs = np.array([rs.rs2_project_point_to_pixel(twin, list(p)) for p in points])
    assert np.abs(lens.project(points) - theirs).max() < 1e-4


def test_pixels_beyond_the_fold_of_a_lens_have_no_ray_and_those_of_the_table_stay_at_its_rim():
    lens = camera("brown_conrady", (-0.3, 0.0, 0.0, 0.0, 0.0))
    rays, table = lens.rays(), ray_table(lens)
    seen = np.isfinite(rays).all(axis=2)
    assert not seen[0, 0] and 0.9 < seen.mean() < 1.0
    assert (table[seen] == rays[seen]).all()
    assert np.hypot(*table[~seen].T).max() <= np.hypot(*rays[seen].T).max() * (1 + 1e-6)


def test_a_measured_point_is_seen_at_its_pixel_and_nothing_behind_the_camera():
    lens, counts = camera("none"), np.random.default_rng(0).integers(1, 9000, (480, 640)).astype(np.uint16)
    counts[:8], counts[8] = 0, 65535
    device, flat = DepthCamera(intrinsics=lens, depth_unit_m=0.0001), np.flatnonzero(valid_depth(counts))
    image = deproject_image(counts, device).reshape(-1, 3)
    points = deproject(counts, device, flat)
    assert np.isnan(image[: 9 * 640]).all() and (image[9 * 640 :] == points).all()
    row, column, inside = nearest_pixels(points.astype(np.float64), lens)
    assert inside.all() and (640 * row + column == flat).all()
    assert not nearest_pixels(-points.astype(np.float64), lens)[2].any()
