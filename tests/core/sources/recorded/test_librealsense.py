"""Recordings are read like by librealsense's own player, pixel for pixel.

The driver runs in separate processes. To test other versions as well, set TACTUNE_OTHER_DRIVERS to their folders,
separated by colons (``pip install --target FOLDER pyrealsense2==2.59.1.11053``).
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from record_cameras import RATE_HZ, START_S, UNITS_M, images, lens_values, run
from tactune.core.model.intrinsics import Intrinsics
from tactune.core.sources.realsense_files.source import BagSource

Opener = Callable[..., BagSource]
FIXTURES = Path(__file__).parents[3] / "data"

_OTHERS = [Path(folder) for folder in os.environ.get("TACTUNE_OTHER_DRIVERS", "").split(":") if folder]
_INSTALLED = [None] if importlib.util.find_spec("pyrealsense2") else []
needs_a_driver = pytest.mark.skipif(not _INSTALLED, reason="pyrealsense2 (extra realsense) is not installed")


def _suffix(driver: Path | None) -> str:
    """The kind of file that a driver records: the installed one below 2.58 a .bag, later ones a .db3."""
    folders = [driver] if driver else [Path(importlib.util.find_spec("pyrealsense2").origin).parents[1]]
    version = next(folders[0].glob("pyrealsense2-*.dist-info")).name.split("-")[1]
    return ".bag" if tuple(map(int, version.split(".")[:2])) < (2, 58) else ".db3"


def _assert_lens(ours: Intrinsics, lens: np.ndarray, model: str) -> None:
    assert [ours.width, ours.height, ours.fx, ours.fy, ours.cx, ours.cy, *ours.coefficients] == lens.tolist()
    assert ours.distortion.value == model


def _assert_as_played(source: BagSource, played: dict[str, np.ndarray], complete: bool = True) -> None:
    """Compare with what librealsense plays; newer versions may miss images until all sensors have started."""
    rig = source.rig
    depth_ms, color_ms = played["Depth_times_ms"], played["Color_times_ms"]
    if complete:
        assert source.length == len(depth_ms)
    compared = 0
    for frame in source:
        time_ms = frame.proximity_time_s * 1e3
        depth, color = int(np.argmin(np.abs(depth_ms - time_ms))), int(np.argmin(np.abs(color_ms - time_ms)))
        if complete or max(abs(depth_ms[depth] - time_ms), abs(color_ms[color] - time_ms)) < 1:
            np.testing.assert_array_equal(frame.proximity_depth, played["Depth"][depth])
            np.testing.assert_array_equal(frame.proximity_color, played["Color"][color])
            assert time_ms == pytest.approx(depth_ms[depth], abs=2e-3)
            compared += 1
    assert compared >= 0.9 * (source.length or 0)
    assert rig.proximity.depth_unit_m == played["unit_m"]
    assert rig.proximity_color is not None
    _assert_lens(rig.proximity.intrinsics, played["Depth_lens"], str(played["Depth_model"]))
    _assert_lens(rig.proximity_color.intrinsics, played["Color_lens"], str(played["Color_model"]))
    T_c_d = np.asarray(rig.proximity_color.T_color_depth)
    np.testing.assert_allclose(T_c_d[:3, :3], played["rotation"].reshape(3, 3).T, atol=1e-6)
    np.testing.assert_allclose(T_c_d[:3, 3], played["translation"], atol=1e-8)


def _played(path: Path, tmp_path: Path, driver: Path | None) -> dict[str, np.ndarray]:
    run("play", path, tmp_path / "played.npz", driver=driver)
    with np.load(tmp_path / "played.npz") as played:
        return dict(played)


@pytest.fixture
def real_bag(shared_data: Path) -> Path:
    return shared_data / "realsense_bag/single_depth_color_640x480.bag"


def test_the_real_bag_is_what_is_known_of_it(open_bag: Opener, real_bag: Path) -> None:
    source = open_bag(real_bag)
    assert (source.rig.proximity.model, source.rig.proximity.serial) == ("Intel RealSense D435", "728612070259")
    assert source.rig.proximity.depth_unit_m == pytest.approx(0.001, rel=1e-6)
    assert source.frame_rate_hz == 6.0
    assert [round(frame.proximity_time_s, 6) for frame in source] == [360.815089, 360.981765]
    source.seek(0)
    assert [int(frame.proximity_depth.sum(dtype=np.int64)) for frame in source] == [357542766, 358061319]


@needs_a_driver
def test_the_real_bag_is_as_librealsense_plays_it(open_bag: Opener, real_bag: Path, tmp_path: Path) -> None:
    _assert_as_played(open_bag(real_bag), _played(real_bag, tmp_path, None))


@needs_a_driver
def test_a_recording_of_an_l515_is_as_librealsense_plays_it(open_bag: Opener, tmp_path: Path) -> None:
    path = FIXTURES / "l515_2.54.2.bag"
    _assert_as_played(open_bag(path), _played(path, tmp_path, None))


@pytest.mark.parametrize("driver", [*_INSTALLED, *_OTHERS], ids=str)
def test_sixty_frames_of_a_pair_go_through_the_recorder_and_come_back(
    open_bag: Opener, tmp_path: Path, driver: Path | None
) -> None:
    suffix, size = _suffix(driver), (320, 240)
    proximity, tactile = tmp_path / f"l515{suffix}", tmp_path / f"d405{suffix}"
    # The second recorder is started three images later and 4 ms out of step.
    run("record", proximity, "l515", 60, "320x240", START_S, driver=driver)
    run("record", tactile, "d405", 60, "320x240", START_S + 3 / RATE_HZ + 0.004, driver=driver)
    source = open_bag(f"{tactile},{proximity}")
    assert source.length == 57
    assert source.health().unmatched == 6
    for index, frame in enumerate(source):
        np.testing.assert_array_equal(frame.proximity_depth, images("l515", index + 3, size)[0])
        np.testing.assert_array_equal(frame.proximity_color, images("l515", index + 3, size)[1])
        depth, color = images("d405", index, size)
        np.testing.assert_array_equal(frame.tactile_depth, depth)
        np.testing.assert_array_equal(frame.tactile_color, color)
        assert frame.skew_s == pytest.approx(0.004, abs=2e-6)
    alone = open_bag(proximity)
    assert alone.length == 60
    _assert_as_played(alone, _played(proximity, tmp_path, driver), complete=False)


@pytest.mark.parametrize("name", ["l515_2.54.2.bag", "d405_2.58.4.db3", "d405_2.59.1.db3"])
def test_recordings_of_three_versions_hold_what_was_sent(open_bag: Opener, name: str) -> None:
    camera = name[:4]
    source = open_bag(FIXTURES / name)
    assert source.length == 3
    assert source.frame_rate_hz == 30.0
    for index in (2, 0, 1):
        depth, color = images(camera, index, (48, 32))
        frame = source.read(index)
        np.testing.assert_array_equal(frame.proximity_depth, depth)
        np.testing.assert_array_equal(frame.proximity_color, color)
        assert frame.proximity_time_s == pytest.approx(START_S + index / RATE_HZ, abs=2e-6)
    rig = source.rig
    assert rig.proximity.model.endswith({"l515": "L515", "d405": "D405"}[camera])
    assert rig.proximity.depth_unit_m == float(np.float32(UNITS_M[camera]))
    values = lens_values(camera, "depth", (48, 32))
    lens = rig.proximity.intrinsics
    found = [lens.fx, lens.fy, lens.cx, lens.cy]
    assert found == pytest.approx([values[key] for key in ("fx", "fy", "ppx", "ppy")], rel=1e-6)


@pytest.mark.parametrize("tactile", ["d405_2.58.4.db3", "d405_2.59.1.db3"])
def test_a_bag_and_a_db3_are_one_source(open_bag: Opener, tactile: str) -> None:
    source = open_bag(f"{FIXTURES / tactile},{FIXTURES / 'l515_2.54.2.bag'}")
    assert source.length == 3
    assert source.health().message == ""
    for index, frame in enumerate(source):
        np.testing.assert_array_equal(frame.proximity_depth, images("l515", index, (48, 32))[0])
        np.testing.assert_array_equal(frame.tactile_depth, images("d405", index, (48, 32))[0])
        assert frame.skew_s == pytest.approx(0.0, abs=2e-6)
