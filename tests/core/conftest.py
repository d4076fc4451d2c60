import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import fast_dds
import folder_scenes
from sockets import free_domain
from tactune.core.model.frames import ColorCamera, DepthCamera, Rig, SensorFrame
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.sources.folder import export_folder


def _pose(baseline_m, turn_deg):
    """Return a pose that turns about all axes, so that no term of it is zero."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([turn_deg / 3, turn_deg, -turn_deg / 2], degrees=True).as_matrix()
    pose[:3, 3] = baseline_m, 0.001, 0.002
    return pose.tolist()


@pytest.fixture(scope="session")
def make_rig():
    """Make a small rig; lenses and the colour camera can be chosen."""

    def make(width=80, height=60, color=True, distortion="none", bend=0.0):
        def lens(focal, shift):
            return Intrinsics(
                width=width, height=height, fx=focal, fy=focal * 1.01, cx=width / 2 - shift, cy=height / 2 + shift,
                distortion=distortion, coefficients=(bend, -bend, bend / 50, -bend / 60, bend / 3),
            )  # fmt: skip

        focal = 0.72 * width
        color_camera = ColorCamera(intrinsics=lens(focal * 1.1, 1.3), T_color_depth=_pose(0.014, 0.5))
        return Rig(
            proximity=DepthCamera(model="L515", serial="P1", intrinsics=lens(focal, 0.4), depth_unit_m=0.00025),
            tactile=DepthCamera(model="D405", serial="T1", intrinsics=lens(focal * 0.95, -0.7), depth_unit_m=0.0001),
            proximity_color=color_camera if color else None,
            T_proximity_tactile=_pose(0.04, -1.0),
        )

    return make


@pytest.fixture(scope="session")
def make_frame():
    """Make a frame of a bumpy surface that both cameras see at nearly the same depth, with holes."""

    def make(rig, seed=0, noise_m=0.004, share_missing=0.1):
        rng = np.random.default_rng(seed)
        height, width = rig.proximity.intrinsics.shape
        v, u = np.mgrid[:height, :width]
        depth = 0.28 + 0.03 * np.sin(u / width * 5) * np.cos(v / height * 4)

        def counts(unit):
            image = np.rint((depth + rng.normal(0, noise_m, depth.shape)) / unit).astype(np.uint16)
            image[rng.random(depth.shape) < share_missing / 2] = 0
            image[rng.random(depth.shape) < share_missing / 2] = 65535
            return image

        return SensorFrame(
            sequence=seed,
            proximity_depth=counts(rig.proximity.depth_unit_m),
            tactile_depth=counts(rig.tactile.depth_unit_m),
            proximity_color=rng.integers(0, 256, (*rig.proximity_color_shape, 3), np.uint8),
        )

    return make


@pytest.fixture
def recording(tmp_path):
    """Two frames with everything that a recording can hold."""
    frames = [folder_scenes.make_frame(seed) for seed in (0, 1, 9)]
    path = tmp_path / "recording"
    export_folder(folder_scenes.list_source(frames[:2], untouched=frames[2]), path)
    return path


@pytest.fixture(scope="session")
def fast_dds_program(tmp_path_factory):
    if not fast_dds.can_build():
        pytest.skip(f"FAST DDS IS NOT TESTED: {fast_dds.HOW_TO_BUILD}")
    return fast_dds.build(tmp_path_factory.mktemp("fast-dds"))


@pytest.fixture
def domain():
    return free_domain()
