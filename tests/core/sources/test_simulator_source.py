"""The simulator as a source: geometry, noise, determinism, cache, and the results of the shipped preset."""

import gc

import numpy as np
import pytest

from tactune.core.errors import ExportError
from tactune.core.sources.simulator import source
from tactune.core.sources.simulator.scene import APEX_M
from tactune.core.sources.simulator.scenes import Variant
from tactune.core.sources.simulator.source import SHIPPED, SimulatorSource, cache_file, load_scene

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


def clean_states(simulator):
    """The states from which a simulator draws its frames, read from its file."""
    scene = simulator.scene
    path = cache_file(scene.name, f"{scene.key} {simulator.rig.model_dump_json()}")
    return (load_scene(SHIPPED / path.name, len(scene.drawn)) or load_scene(path, len(scene.drawn))).states


def test_a_scene_is_solved_once_and_a_damaged_file_or_a_full_disk_does_no_harm(tmp_path, monkeypatch):
    monkeypatch.setattr(source, "user_cache_dir", lambda name: str(tmp_path / name))
    solved, solve = [], SimulatorSource.solve_anew

    def counted(*given):
        solved.append(1)
        return solve(*given)

    def refuse(*_):
        raise ExportError("cannot write: disk full; choose another place")

    def open_again():
        gc.collect()  # open sources share their scene; none is open now
        simulator = SimulatorSource("cube", variant=Variant(press="low"), cells=(36, 20))
        return images(simulator.read(3)), simulator.facts(3)

    monkeypatch.setattr(SimulatorSource, "solve_anew", counted)
    first, again = open_again(), open_again()
    assert len(solved) == 1
    (kept,) = (tmp_path / "tactune" / "simulator").iterdir()
    kept.write_bytes(kept.read_bytes()[:1000])
    monkeypatch.setattr(source, "save_scene", refuse)
    damaged = open_again()
    assert len(solved) == 2
    for other in (again, damaged):
        assert all(np.array_equal(a, b) for a, b in zip(first[0], other[0], strict=True))
        assert other[1] == first[1]


def test_the_default_scene_comes_with_the_package(tmp_path, monkeypatch):
    """If it does not: run scripts/ship_scene.py."""
    simulator = SimulatorSource()
    monkeypatch.setattr(source, "user_cache_dir", lambda name: str(tmp_path))
    assert len(clean_states(simulator)) == len(simulator.scene.drawn)
