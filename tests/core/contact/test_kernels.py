"""The kernels: the coarse test is safe, the colour test is OpenCV's, machine code is cached and never stale."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tactune.core.contact.alignment import make_alignment
from tactune.core.contact.kernels import compiling
from tactune.core.contact.kernels.coarse import tile_grid
from tactune.core.contact.kernels.colors import hsv_limits, lanes_in_range
from tactune.core.contact.kernels.compiling import kernel
from tactune.core.contact.kernels.simd import LANES, bits, load_colors
from tactune.core.contact.kernels.tolerance import TILE_ROWS
from tactune.core.contact.masking import in_hsv_range
from tactune.core.contact.pixels import Pixels, Workspace, depth_images
from tactune.core.preset import MaskSection, Preset

PRESET = Preset(contact_test="tolerance")


def pixels_of(preset, rig):
    return Pixels(preset, rig, make_alignment(preset.alignment, rig), Workspace(rig))


def tiles_with_candidates(preset, rig, frame):
    v, u = np.divmod(pixels_of(preset, rig).agreeing(frame, preset.tolerance.t), frame.proximity_depth.shape[1])
    tiles = np.zeros(tile_grid(frame.proximity_depth.shape[1], frame.proximity_depth.shape[0]), bool)
    tiles[v // TILE_ROWS, u // LANES] = True
    return tiles


def marked(preset, rig, frame):
    pixels = pixels_of(preset, rig)
    tiles, count = pixels.coarse.tiles(depth_images(frame), pixels.test(preset.tolerance.t).limits)
    assert count == tiles.sum()
    return tiles


def lifted(frame, rig, gap_m, where):
    """Move the proximity surface away from the membrane except in some places."""
    counts = frame.proximity_depth.astype(np.int64)
    away = round(gap_m / rig.proximity.depth_unit_m)
    moved = np.where((counts > 0) & (counts < 65535) & ~where, counts + away, counts)
    return type(frame)(
        frame.sequence, np.clip(moved, 0, 65535).astype(np.uint16), frame.tactile_depth, frame.proximity_color
    )


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 10_000), model=st.sampled_from(["rigid", "homography"]),
    width=st.sampled_from([160, 97, 40, 11]), gap_m=st.floats(-0.2, 0.3),
    t=st.sampled_from([0.0, 0.003, 0.02, 0.3, 1.0]), noise_m=st.sampled_from([0.0, 0.002, 0.05]),
    offset_m=st.floats(-0.02, 0.02), limits=st.booleans(),
)  # fmt: skip
def test_no_candidate_is_ever_ruled_out(make_rig, make_frame, seed, model, width, gap_m, t, noise_m, offset_m, limits):
    rig = make_rig(width=width)
    frame = make_frame(rig, seed, noise_m)
    rng = np.random.default_rng(seed)
    where = np.zeros(frame.proximity_depth.shape, bool)
    v, u = rng.integers(0, where.shape[0]), rng.integers(0, where.shape[1])
    where[v : v + 7, u : u + 5] = True
    frame = lifted(frame, rig, gap_m, where)
    preset = PRESET.with_values(
        {
            "alignment.model": model, "alignment.depth_offset_m": offset_m, "tolerance.t": t,
            "range.enabled": limits, "range.limits_m": (0.2, 0.3),
        }
    )  # fmt: skip
    assert not (tiles_with_candidates(preset, rig, frame) & ~marked(preset, rig, frame)).any()


def test_what_lies_behind_the_images_in_memory_changes_nothing(make_rig, make_frame):
    rig = make_rig(width=90, height=64)
    frame = make_frame(rig, noise_m=0.0)
    apart = lifted(frame, rig, 0.1, np.zeros(frame.proximity_depth.shape, bool))

    def followed_by(image, count):
        memory = np.full(image.size + 64, count, np.uint16)
        memory[: image.size] = image.ravel()
        return memory[: image.size].reshape(image.shape)

    for membrane_m, object_m in ((0.0, 0.0), (0.38, 0.28)):  # then each image is followed by what the other one sees
        proximity = followed_by(apart.proximity_depth, round(object_m / rig.proximity.depth_unit_m))
        tactile = followed_by(apart.tactile_depth, round(membrane_m / rig.tactile.depth_unit_m))
        assert not marked(PRESET, rig, replace(apart, proximity_depth=proximity, tactile_depth=tactile)).any()


def test_every_colour_has_opencvs_hue_saturation_and_value():
    steps = np.unique(np.r_[np.arange(0, 256, 5), 1, 2, 127, 128, 254, 255]).astype(np.uint8)
    colors = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    hue, saturation, value = cv2.cvtColor(colors[None], cv2.COLOR_RGB2HSV)[0].T
    for section in (
        MaskSection(hue=(30, 90)), MaskSection(hue=(150, 20)),
        MaskSection(saturation=(60, 200)), MaskSection(value=(3, 99)),
    ):  # fmt: skip
        low, high = section.hue
        expected = (low <= hue) & (hue <= high) if low <= high else (low <= hue) | (hue <= high)
        for channel, (floor, ceiling) in ((saturation, section.saturation), (value, section.value)):
            expected &= (floor <= channel) & (channel <= ceiling)
        assert np.array_equal(in_hsv_range(colors, section), expected)
        inside = np.zeros(len(colors), bool)
        lanes_in_range_of(colors.reshape(-1), hsv_limits(section), inside)
        assert np.array_equal(inside, expected)


@kernel
def lanes_in_range_of(image, limits, inside):
    for start in range(0, len(inside), LANES):
        place = min(start, len(inside) - LANES)
        red, green, blue = load_colors(image, place)
        found = bits(lanes_in_range(red, green, blue, limits))
        for lane in range(LANES):
            inside[place + lane] = (found >> lane) & 1 == 1


_PROGRAM = """
import sys
sys.path.insert(0, {folder!r})
from small.core.outer import doubled
print(doubled(21.0))
"""


@pytest.fixture
def package(tmp_path):
    """A package like ours: a kernel that takes a function of another module in."""
    core = tmp_path / "small" / "core"
    core.mkdir(parents=True)
    (tmp_path / "small" / "__init__.py").write_text("")
    (core / "__init__.py").write_text("")
    shutil.copy(Path(compiling.__file__), core / "compiling.py")
    (core / "inner.py").write_text("from .compiling import inline\n\n\n@inline\ndef factor():\n    return 2.0\n")
    (core / "outer.py").write_text(
        "from .compiling import kernel\nfrom .inner import factor\n\n\n"
        "@kernel\ndef doubled(x):\n    return x * factor()\n"
    )
    return tmp_path


def _run(folder):
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    program = [sys.executable, "-c", _PROGRAM.format(folder=str(folder))]
    return float(subprocess.run(program, capture_output=True, text=True, check=True, env=environment).stdout)


def test_a_change_in_another_module_reaches_the_kernel(package):
    assert _run(package) == 42.0
    assert list(package.rglob("outer.doubled-*.nbi"))
    inner = package / "small" / "core" / "inner.py"
    inner.write_text(inner.read_text().replace("2.0", "3.0"))
    os.utime(inner, ns=(1, inner.stat().st_mtime_ns + 1_000_000))
    assert _run(package) == 63.0


SUPPORT = Path(__file__).resolve().parents[2] / "support"

PROCESS = """
import numpy as np
from tactune.core.warmup import is_compiled, warm_up, warm_up_test
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.preset import Preset
from fakes import tiny_frame, tiny_rig
"""


def run(program, **environment):
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", PROCESS + program],
        check=False, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(SUPPORT)} | environment,
        timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_kernels_are_kept_where_the_environment_says(tmp_path):
    program = """
from tactune.core.contact.kernels.compiling import compiled_so_far, is_kept
from tactune.core.contact.kernels.colors import color_lookup
from tactune.core.contact.pixels import colors_at
from tactune.core.model.frames import ColorCamera
rig = tiny_rig()
color = ColorCamera(intrinsics=rig.tactile.intrinsics, T_color_depth=np.eye(4))
rig = rig.model_copy(update={"proximity_color": color})
print(is_compiled(), is_kept(color_lookup))
colors_at(np.ones((2, 3), np.float32), np.arange(2), np.zeros((*rig.tactile.intrinsics.shape, 3), np.uint8), rig)
print(compiled_so_far())
"""
    first = run(program, NUMBA_CACHE_DIR=str(tmp_path))
    assert first.startswith("False False\nCompiled(loaded=0, compiled=1")
    assert str(tmp_path) in first
    again = run(program, NUMBA_CACHE_DIR=str(tmp_path))
    assert again.startswith("False True\nCompiled(loaded=1, compiled=0")


def test_no_frame_waits_for_a_compiler():
    program = """
from dataclasses import replace
from tactune.core.contact.kernels.compiling import compiled_so_far
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.scenes import Variant
from tactune.core.sources.simulator.simulator_source import SimulatorSource
source = SimulatorSource("cup", seed=3, variant=Variant(press="medium"), cells=(60, 36))
frames, untouched = [source.read(index) for index in range(2)], source.with_object_away().read(0)
frames.append(replace(frames[0], proximity_color=frames[0].proximity_color // 2))  # in half of the light
plain = load_preset("simulator").with_value("mask.value", (110, 255))  # in half of the light no print is so bright
for values in ({"membrane.bias": False}, {}, {"membrane.frames": 2}, {"contact_test": "pressure"}):  # each needs more
    preset = plain.with_values(values)
    warm_up_test(preset, lambda share, words: None)
    before = compiled_so_far()
    pipeline = ContactPipeline(preset, source.rig, untouched)
    for frame in frames:
        patch = pipeline.process(frame)
    after = compiled_so_far()
    print(len(patch.points) > 1000, after.loaded - before.loaded, after.compiled - before.compiled)
"""
    assert run(program).split() == ["True", "0", "0"] * 4
