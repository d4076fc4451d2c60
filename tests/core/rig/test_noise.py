"""The noise of both cameras and the bias between them are what was put in: a wall, and the simulator's sensors."""

import math
from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest

from rigs import one_place_rig
from side_by_side import HEIGHT, WIDTH, counts, rig
from tactune.core.errors import FrameError
from tactune.core.model.frames import Rig, SensorFrame, Shot
from tactune.core.preset import Preset
from tactune.core.rig import noise as noise_module
from tactune.core.rig.bias import print_bias, scene_bias
from tactune.core.rig.noise import describe, measure_noise
from tactune.core.rig.untouched import untouched_frame
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.noise import STEREO_BASELINE_M, TOF_DISTANCE_SHARE
from tactune.core.sources.simulator.scenes import Variant
from tactune.core.sources.simulator.sensors import SENSORS
from tactune.core.sources.simulator.simulator_source import SimulatorSource

__all__ = ["rig"]

#: The colour that the mask takes for prints, and another one.
PRINT, OTHER = (214, 40, 160), (120, 120, 120)
MASK = {"mask.enabled": True, "mask.hue": (145, 175), "mask.saturation": (110, 255), "mask.value": (60, 255)}
BIAS_M = 0.003
PRINTS = ((60, 40), (90, 80), (70, 90), (110, 40))


def field(seed, white_m, correlated_m, length_px, shape=(HEIGHT, WIDTH)):
    """White noise plus noise that neighbours share."""
    rng = np.random.default_rng(seed)
    shared = cv2.GaussianBlur(rng.normal(size=(2 * HEIGHT, 2 * WIDTH)), (0, 0), length_px)
    return rng.normal(0, white_m, shape) + correlated_m * shared[:HEIGHT, :WIDTH] / shared.std()


def wall(rig, index, proximity_m=0.300, tactile_m=0.300, prints=True):
    """A wall with prints; the proximity camera reads `BIAS_M` farther, half of the correlated variance stays."""
    root = math.sqrt(0.5)
    color = np.full((HEIGHT, WIDTH, 3), OTHER, np.uint8)
    if prints:
        for u, v in PRINTS:
            color[v - 8 : v + 8, u - 8 : u + 8] = PRINT
    near = field(index, 0.0006, root * 0.0005, 2.0) + field(10_001, 0.0, root * 0.0005, 2.0)
    far = field(5000 + index, 0.0002, root * 0.0010, 3.0) + field(10_002, 0.0, root * 0.0010, 3.0)
    return SensorFrame(
        sequence=index,
        proximity_depth=counts(proximity_m + BIAS_M + near, rig.proximity),
        tactile_depth=counts(tactile_m + far, rig.tactile),
        proximity_color=color,
    )


@pytest.fixture(scope="module")
def preset():
    return Preset().with_values({"alignment.model": "rigid", **MASK})


@pytest.fixture(scope="module")
def still(rig):
    return [wall(rig, index) for index in range(40)]


@pytest.fixture
def pressed_is(monkeypatch):
    """Return a function that says which firm contact the membrane test finds in a frame."""
    return lambda contact: monkeypatch.setattr(noise_module, "firm_contact_bias", lambda preset, rig: contact)


def test_a_wall_gives_back_its_noise_and_bias(rig, preset, still, pressed_is):
    shares = []
    pressed_is(lambda frame: None)
    noise = measure_noise(still, rig, preset, progress=lambda share, _: shares.append(share))
    assert noise.proximity.white_m == pytest.approx(0.0006, rel=0.1)
    assert noise.proximity.correlated_m == pytest.approx(0.0005, rel=0.2)
    assert noise.proximity.length_px == pytest.approx(2.0, rel=0.2)
    assert noise.proximity.changing_share == pytest.approx((0.36 + 0.125) / 0.61, abs=0.08)
    assert noise.tactile.correlated_m == pytest.approx(0.0010, rel=0.2)
    assert noise.tactile.length_px == pytest.approx(3.0, rel=0.2)
    assert noise.tactile.changing_share == pytest.approx((0.04 + 0.5) / 1.04, abs=0.1)
    assert noise.bias_from == "prints"
    assert abs(noise.bias_m - BIAS_M) < 2 * noise.bias_sigma_m < 0.0015
    assert (noise.bias_per_m, noise.frames) == (0.0, 40)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


def test_of_a_recording_the_frames_before_a_press_are_measured(rig, preset, still):
    pressed = [wall(rig, index, tactile_m=0.29) for index in range(40, 60)]
    assert measure_noise([*still, *pressed], rig, preset).frames == 40


def test_noise_of_depth_in_millimetres_is_not_lost(preset):
    """Most pixels then have the same count twice."""
    rig = Rig.of_one_camera(one_place_rig(WIDTH, HEIGHT, 90.0, tactile_unit_m=0.001).tactile)
    depths = [np.rint(1000 * (0.13 + field(index, 0.0002, 0.0003, 2.0))).astype(np.uint16) for index in range(20)]
    frames = [SensorFrame.of_shots(rig, index, None, Shot(depth, None, 0.0)) for index, depth in enumerate(depths)]
    noise = measure_noise(frames, rig, preset).tactile
    assert noise.total_m == pytest.approx(np.std(depths) / 1000, rel=0.1)
    assert noise.changing_share > 0.9


def test_too_few_frames_motion_and_no_depth_are_refused(rig, preset, still):
    with pytest.raises(FrameError, match=r"10 different frames .*, there are 9"):
        measure_noise(still[:9] * 3, rig, preset)
    moving = [wall(rig, index, proximity_m=0.3 + 0.0004 * index) for index in range(20)]
    with pytest.raises(FrameError, match=r"the scene moves: the proximity depth changes in .* hold everything still"):
        measure_noise(moving, rig, preset)
    shaken = [wall(rig, index, proximity_m=0.3 + 0.02 * (-1) ** index) for index in range(20)]
    with pytest.raises(FrameError, match=r"the proximity depth changes in 100 % .* by \d+ mm near pixel"):
        measure_noise(shaken, rig, preset)
    blind = [replace(frame, tactile_depth=np.zeros_like(frame.tactile_depth)) for frame in still[:20]]
    with pytest.raises(FrameError, match=r"the tactile camera sees depth in only 0\.0 %"):
        measure_noise(blind, rig, preset)
    in_centimetres = rig.model_copy(update={"tactile": rig.tactile.model_copy(update={"depth_unit_m": 0.01})})
    with pytest.raises(FrameError, match=r"300 m .* the tactile camera .* depth unit, 0\.01 m"):
        measure_noise(still, in_centimetres, preset)


def test_a_scene_without_smooth_surfaces_is_refused(rig, preset, still):
    holes = np.ones((HEIGHT, WIDTH), bool)
    holes[::3] = False
    frames = [replace(frame, proximity_depth=frame.proximity_depth * holes) for frame in still[:12]]
    with pytest.raises(FrameError, match=r"the proximity camera sees no smooth surface"):
        measure_noise(frames, rig, preset)
    tiny = one_place_rig(7, 3, 10.0)
    depth, color = np.full((3, 7), 1200, np.uint16), np.zeros((3, 7, 3), np.uint8)
    with pytest.raises(FrameError, match=r"the tactile camera sees no smooth surface"):
        measure_noise([SensorFrame(index, depth, depth, color) for index in range(12)], tiny, preset)


def test_without_prints_the_bias_is_unknown_and_contact_tells_it(rig, preset, pressed_is):
    frames = [wall(rig, index, prints=False) for index in range(12)]
    pressed_is(lambda frame: None)
    unknown = measure_noise(frames, rig, preset)
    assert (unknown.bias_from, unknown.bias_m, unknown.bias_sigma_m) == ("unknown", 0.0, 0.005)
    assert "press an object firmly (1,000 mm² or more)" in describe(unknown)[2]
    pressed_is(lambda frame: (0.003 + 0.0001 * (frame.sequence % 3), 0.002))
    pressed = measure_noise(frames, rig, preset)
    assert pressed.bias_from == "contact"
    assert pressed.bias_m == pytest.approx(0.0031)
    assert "3.1 ± " in describe(pressed)[2]
    assert "measured in firm contact" in describe(pressed)[2]


def test_prints_that_disagree_with_each_other_tell_no_bias(rig, preset):
    """The proximity camera looks through them, to whatever lies behind each."""
    frame = wall(rig, 0)
    depth = frame.proximity_depth.copy()
    for number, (u, v) in enumerate(PRINTS):
        depth[v - 10 : v + 10, u - 10 : u + 10] += np.uint16(number * 0.009 / rig.proximity.depth_unit_m)
    assert print_bias([frame], rig, preset, 1e-10).origin == "prints"
    assert print_bias([replace(frame, proximity_depth=depth)], rig, preset, 1e-10) is None


@pytest.mark.parametrize("bias_m", [0.005, -0.005])
def test_a_scene_tells_the_bias_only_if_it_is_not_flat(bias_m):
    flat = np.full((HEIGHT, WIDTH), 0.3, np.float32)
    relief = flat + np.linspace(0, 0.1, WIDTH, dtype=np.float32)
    difference = np.full_like(flat, bias_m)
    assert scene_bias(relief, difference, 1.0).bias_m == pytest.approx(bias_m)
    assert scene_bias(flat, difference).bias_m == pytest.approx(bias_m)
    assert scene_bias(flat, difference, 1.0) is None


# The simulator's sensors


@lru_cache(maxsize=1)
def _scene():
    """The flat mesh of an untouched membrane, kept open so that every sensor uses the same solved scene."""
    return SimulatorSource("cube", cells=(60, 36), variant=Variant(press="none"), sensor="datasheet")


def judge(found, white_m, correlated_m, length_px, fixed_share, step_m):
    """Compare with the model, in the parts that exceed the quantisation."""
    quantised = step_m / math.sqrt(12)
    if white_m > quantised:
        assert found.white_m == pytest.approx(math.hypot(white_m, quantised), rel=0.3)
    if correlated_m > step_m:
        assert found.correlated_m == pytest.approx(correlated_m, rel=0.3)
        assert found.length_px == pytest.approx(length_px, rel=0.3)
    if max(white_m, correlated_m) > step_m:
        changing = 1 - fixed_share * correlated_m**2 / (white_m**2 + correlated_m**2)
        assert found.changing_share == pytest.approx(changing, rel=0.3)


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name == "far-offset" else pytest.mark.long) for name in SENSORS]
)
def test_a_simulated_sensor_gives_back_its_model(name):
    _scene()
    source = SimulatorSource("cube", cells=(60, 36), variant=Variant(press="none"), sensor=name)
    frames = [source.read(index) for index in range(source.length)]
    noise = measure_noise(frames, source.rig, load_preset("simulator"), untouched_frame(source))
    model, rig = SENSORS[name], source.rig
    growth = 1 - TOF_DISTANCE_SHARE + TOF_DISTANCE_SHARE * noise.proximity.distance_m / 0.3
    near = model.tof_white_m * growth, model.tof_correlated_m * growth, model.tof_correlated_px
    judge(noise.proximity, *near, model.tof_correlated_fixed_share, rig.proximity.depth_unit_m)
    metres_per_px = noise.tactile.distance_m**2 / (rig.tactile.intrinsics.fx * STEREO_BASELINE_M)
    step_m = metres_per_px / model.stereo_subpixel_steps if model.stereo_subpixel_steps else 1e-4
    far = model.stereo_white_px * metres_per_px, model.stereo_correlated_px * metres_per_px, model.stereo_length_px
    judge(noise.tactile, *far, model.stereo_fixed_share, step_m)
    if not model.exact:  # an exact camera looks through the prints, too
        assert noise.bias_from != "unknown"
        bias_m = model.tof_offset_m + (model.tof_scale - 1) * 0.285
        assert abs(noise.bias_m - bias_m) < max(0.0003, 2 * noise.bias_sigma_m)
        assert noise.bias_sigma_m < 0.0025
