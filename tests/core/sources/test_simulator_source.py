"""The simulator as a source: scenes, geometry, noise, determinism, cache, systematic errors of its sensors."""

import gc
from dataclasses import asdict, replace

import numpy as np
import pytest

from tactune.core.errors import ExportError, SourceError
from tactune.core.sources.simulator import simulator_source
from tactune.core.sources.simulator.noise import NoiseModel
from tactune.core.sources.simulator.render import CLEAN_UNIT_M
from tactune.core.sources.simulator.scene import APEX_M, RIM_M, CleanState, simulator_rig
from tactune.core.sources.simulator.scenes import MEMBRANES, STANDARD, Variant, read_name, write_name
from tactune.core.sources.simulator.sensors import SENSORS
from tactune.core.sources.simulator.simulator_source import SHIPPED, SimulatorSource, cache_file, load_scene

REST, DEEP = 0, 45


@pytest.fixture(scope="module")
def cup():
    return SimulatorSource("cup", sensor="datasheet")


@pytest.fixture(scope="module")
def exact():
    return SimulatorSource("cup", noise=0.0)


def images(frame):
    return frame.proximity_depth, frame.tactile_depth, frame.proximity_color, frame.tactile_color


def test_frames_fit_the_rig_and_the_apex_is_where_it_belongs(exact):
    frame = exact.read(REST)
    frame.check_against(exact.rig)
    assert frame.tactile_color.shape == (480, 640, 3)
    assert not frame.truth.contact.any()
    assert np.nanmax(frame.truth.depth_m) == pytest.approx(APEX_M, abs=1e-4)
    assert exact.length == 90
    assert frame.skew_s != 0.0


def test_object_depth_meets_the_membrane_in_contact_only(exact):
    frame, unit = exact.read(DEEP), exact.rig.proximity.depth_unit_m
    difference = frame.proximity_depth * unit - frame.truth.depth_m
    assert np.quantile(np.abs(difference[frame.truth.contact]), 0.97) < 1.5e-3
    assert np.median(difference[~frame.truth.contact & np.isfinite(difference)]) > 0.1
    assert np.nanmin(difference[frame.proximity_depth > 0]) > -2.5e-3


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_frames_depend_on_seed_and_index_only(noise):
    one, two = (SimulatorSource("cup", seed=4, noise=noise) for _ in range(2))
    forward = [images(one.read(n)) for n in (0, 30, 31, 89)]
    backward = [images(two.read(n)) for n in (89, 31, 30, 0)][::-1]
    for a, b in zip(forward, backward, strict=True):
        assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))
    other = SimulatorSource("cup", seed=5, noise=noise)
    same = [np.array_equal(x, y) for x, y in zip(images(other.read(0)), forward[0], strict=True)]
    assert same == [noise == 0.0] * 4


def test_a_scene_is_solved_once_and_a_damaged_file_or_a_full_disk_does_no_harm(tmp_path, monkeypatch):
    monkeypatch.setattr(simulator_source, "user_cache_dir", lambda name: str(tmp_path / name))
    solved, told, solve = [], [], SimulatorSource.solve_anew

    def counted(*given):
        solved.append(1)
        return solve(*given)

    def refuse(*_):
        raise ExportError("cannot write: disk full; choose another place")

    def open_again():
        gc.collect()  # open sources share their scene; none is open now
        simulator = SimulatorSource(
            "cube", progress=lambda *each: told.append(each), variant=Variant(press="low"), cells=(36, 20)
        )
        return images(simulator.read(3)), simulator.facts(3)

    monkeypatch.setattr(SimulatorSource, "solve_anew", counted)
    first, again = open_again(), open_again()
    assert len(solved) == 1
    shares = [share for share, words in told if words == "Computing the scene “cube low”"]
    assert len(set(shares)) > 2 and shares == sorted(shares), "a still press is drawn once, after many steps"
    (kept,) = (tmp_path / "tactune" / "simulator").iterdir()
    kept.write_bytes(kept.read_bytes()[:1000])
    monkeypatch.setattr(simulator_source, "save_scene", refuse)
    damaged = open_again()
    assert len(solved) == 2
    for other in (again, damaged):
        assert all(np.array_equal(a, b) for a, b in zip(first[0], other[0], strict=True))
        assert other[1] == first[1]


def test_the_default_scene_comes_with_the_package():
    """If it does not: run scripts/ship_scene.py."""
    scene, rig = SimulatorSource().scene, simulator_rig()
    file = cache_file(scene.name, f"{scene.key} {rig.model_dump_json()}")
    assert len(load_scene(SHIPPED / file.name, len(scene.drawn)).states) == len(scene.drawn)


COARSE = (60, 36)


def open_coarse(scene, noise=0.0, **variant):
    return SimulatorSource(scene, noise=noise, cells=COARSE, variant=Variant(**variant), sensor="datasheet")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("teapot", "scene is 'teapot'; choose one of cube, cup"),
        ("cube?press=hard", "press is 'hard'; choose one of none, low, medium, high"),
        ("cube?press=low&gap=3", "press, gap and move exclude each other"),
        ("cube?press=low&side=left", "side is for press=high"),
        ("tray?move=slide", "the tray rolls"),
        ("cup?move=slide&membrane=sticky", "on the membrane sticky nothing slides"),
        ("cube?membrane=drum", "membrane is 'drum'; choose one of standard, soft, taut, tall, uneven"),
        ("cube?sensor=eye", "sensor is 'eye'"),
        ("cube?seed=-1", "seed is '-1'"),
        ("cube?light=dim", "no option 'light'"),
        ("cube?seed", "are no options"),
        ("cup?seed=1&seed=2", "an option is named twice"),
    ],
)
def test_impossible_names_are_refused(name, words):
    with pytest.raises(SourceError, match=words):
        read_name(name)


def test_a_name_is_written_without_what_is_the_default():
    name = "octopus?press=high&side=left&membrane=soft&sensor=worn&seed=3&noise=0.5"
    assert write_name(**read_name(name)) == f"sim:{name}"
    assert write_name(**read_name("?side=right&seed=0&noise=1")) == "sim:cup"


def test_hovering_object_keeps_its_gap():
    gap_mm = 20.0
    with open_coarse("cube", gap_mm=gap_mm) as source:
        frame = source.read(0)
        assert source.facts(0).depth_m == pytest.approx(-gap_mm / 1e3)
        assert not frame.truth.contact.any()
        behind = frame.proximity_depth * 0.00025 - frame.truth.depth_m
        assert np.nanquantile(behind[frame.truth.depth_m > 0], 0.0005) == pytest.approx(gap_mm / 1e3, abs=1.5e-3)


@pytest.mark.parametrize(
    ("membrane", "shape", "press"),
    [
        ("sticky", "cup", "medium"),
        *(pytest.param(name, "cube", press, marks=pytest.mark.long) for name in MEMBRANES for press in ("low", "high")),
    ],
)
def test_every_membrane_is_solved_and_has_its_rim_at_the_same_place(membrane, shape, press):
    design = MEMBRANES[membrane]
    with open_coarse(shape, press="none", membrane=membrane) as source:
        frame, rest = source.read(0), source.facts(0)
        assert np.nanmax(frame.truth.depth_m) == pytest.approx(RIM_M + design.apex_m, abs=2e-4)
        assert rest.residual < 1e-3
        assert ("membrane=" in source.name) is (membrane != STANDARD)
    with open_coarse(shape, press=press, membrane=membrane) as source:
        facts = source.facts(0)
        assert facts.residual < 1e-3
        assert 0.02 < facts.strain.length < 3.0
        assert source.read(0).truth.contact.sum() > 300
        with source.with_object_away() as away:
            assert away.scene.design == source.scene.design


RIG = simulator_rig()
#: A wall at 0.3 m that faces both cameras.
WALL = np.full((480, 640), round(0.3 / CLEAN_UNIT_M), dtype=np.uint16)
FACING, PLAIN = np.full(WALL.shape, 255, dtype=np.uint8), np.zeros(WALL.shape, dtype=np.uint8)


def proximity_error(model):
    """Error of the proximity camera on the wall in metres, NaN where there is no depth."""
    counts = model.proximity_depth(0, CleanState(WALL, WALL, FACING, PLAIN, PLAIN, WALL, PLAIN, WALL))
    return np.where(counts > 0, counts * RIG.proximity.depth_unit_m - WALL * CLEAN_UNIT_M, np.nan)


@pytest.mark.parametrize("name", ["datasheet", "l515-d405", "worn", "far-offset"])
def test_systematic_errors_are_as_the_model_says(name):
    sensor = SENSORS[name]
    shared = replace(sensor, tof_correlated_m=0.0, tof_slow_bias_m=0.0, tof_drift_m=0.0, stereo_hole_share=0.01)
    error = proximity_error(NoiseModel(RIG, 0, 1.0, shared))
    assert np.nanmean(error) == pytest.approx(sensor.tof_offset_m + 0.3 * (sensor.tof_scale - 1.0), abs=2e-5)
    turn = np.radians(sensor.tof_slope_deg)
    across = np.nanmean(error[:, 540:]) - np.nanmean(error[:, :100])
    assert across == pytest.approx(sensor.tof_slope_m * np.cos(turn) * 540 / 640, abs=5e-5)
    down = np.nanmean(error[380:]) - np.nanmean(error[:100])
    assert down == pytest.approx(sensor.tof_slope_m * np.sin(turn) * 380 / 640, abs=5e-5)
    assert np.isnan(error).mean() == pytest.approx(sensor.tof_dropout_share, rel=0.1)


def test_no_noise_is_the_clean_sensor_and_noise_is_a_factor_on_all_errors():
    clean = NoiseModel(RIG, 0, 1.0, SENSORS["clean"])
    for sensor in (SENSORS["l515-d405"], SENSORS["worn"]):
        none = NoiseModel(RIG, 0, 0.0, sensor)
        assert np.array_equal(proximity_error(none), proximity_error(clean))
        assert np.array_equal(none.tactile_depth(2, WALL), clean.tactile_depth(2, WALL))
    far = SENSORS["far-offset"]
    for level in (0.5, 2.0):
        error = proximity_error(NoiseModel(RIG, 0, level, far))
        assert np.nanmean(error) == pytest.approx(0.020 * level, abs=2e-4)


@pytest.mark.long
@pytest.mark.parametrize("file", ["cup-118", "cup-none"])
def test_the_shipped_scene_is_the_solver_s(file):
    (path,) = SHIPPED.glob(f"{file}*.npz")
    simulator = SimulatorSource() if file == "cup-118" else SimulatorSource().with_object_away()
    solved = simulator.solve_anew(simulator.scene, lambda share, words: None)
    shipped = load_scene(path, len(solved.states))
    # Other processors round the last digits otherwise.
    for ours, theirs in zip(shipped.facts, solved.facts, strict=True):
        assert flat(asdict(ours)) == pytest.approx(flat(asdict(theirs)), rel=1e-6, abs=1e-9, nan_ok=True)
    for ours, theirs in zip(shipped.states, solved.states, strict=True):
        for name, image in theirs._asdict().items():
            assert np.count_nonzero(getattr(ours, name) != image) <= 1e-5 * image.size, name


def flat(facts):
    numbers = []
    for value in facts.values():
        numbers += flat(value) if isinstance(value, dict) else np.ravel(np.asarray(value, float)).tolist()
    return numbers
