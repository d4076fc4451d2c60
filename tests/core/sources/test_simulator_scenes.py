"""The simulator's scenes: names, options, and their differences."""

from __future__ import annotations

import numpy as np
import pytest

from tactune.core.errors import SourceError
from tactune.core.sources.simulator.between import state_between
from tactune.core.sources.simulator.cache import cache_file, find_solved
from tactune.core.sources.simulator.membranes import MEMBRANES, STANDARD
from tactune.core.sources.simulator.render import CLEAN_UNIT_M, CONTACT_FLAG
from tactune.core.sources.simulator.scene import RIM_M
from tactune.core.sources.simulator.scenes import HELD_OUT, Variant, light_table, resolve_scene
from tactune.core.sources.simulator.source import SimulatorSource
from tactune.core.sources.simulator.tray import BOOKS, SECONDS

COARSE = (60, 36)


def open_coarse(scene, noise=0.0, light="normal", **variant):
    return SimulatorSource(
        scene, noise=noise, cells=COARSE, variant=Variant(**variant), light=light, sensor="datasheet"
    )


@pytest.mark.parametrize(
    ("scene", "variant", "words"),
    [
        ("teapot", Variant(), "no scene 'teapot'; choose one of cube, cup"),
        ("hover", Variant(object="teapot"), "object is 'teapot'"),
        ("cube", Variant(object="octopus"), "object is for hover"),
        ("cube", Variant(press="hard"), "press is 'hard'; choose one of none, low, medium, high"),
        ("hover", Variant(press="low"), "press is for scenes of an object"),
        ("cube", Variant(gap_mm=3.0), "gap is for hover"),
        ("hover", Variant(gap_mm=0.0), "gap is 0"),
        ("hover", Variant(gap_mm=float("nan")), "gap is nan"),
        ("cube", Variant(press="low", side="left"), "side is for press=high"),
        ("cube", Variant(grid="lines"), "grid is 'lines'"),
        ("cup", Variant(move="roll"), "move is 'roll'; choose one of slide, lift"),
        ("hover", Variant(move="slide"), "move is for scenes of an object"),
        ("cube", Variant(move="lift"), "only the cup's handle can be lifted"),
        ("cup", Variant(move="slide", press="low"), "a press is held, a move is not"),
        ("cup", Variant(move="slide", membrane="sticky"), "on the membrane sticky nothing slides"),
        ("cube", Variant(membrane="drum"), "membrane is 'drum'; choose one of standard, soft, taut, tall, uneven"),
    ],
)
def test_impossible_scenes_are_refused(scene, variant, words):
    with pytest.raises(SourceError, match=words):
        resolve_scene(scene, variant)


def test_still_presses_grow_and_only_their_noise_changes():
    areas, strains = [], []
    for press in ("low", "medium"):
        with open_coarse("cube", noise=1.0, press=press) as source:
            first, last = source.read(0), source.read(source.length - 1)
            assert np.array_equal(first.truth.contact, last.truth.contact)
            assert not np.array_equal(first.proximity_depth, last.proximity_depth)
            areas.append(first.truth.contact.sum())
            strains.append(source.facts(0).strain_length)
    assert 0 < areas[0] < areas[1]
    assert strains[0] < strains[1]


def test_without_a_press_nothing_touches_the_same_membrane_and_the_noise_is_another():
    with open_coarse("cube", noise=1.0, press="medium") as pressed, pressed.with_object_away() as away:
        first, frame = pressed.read(0), away.read(0)
        assert "press=none" in away.name
        assert away.scene.design == pressed.scene.design
        assert away.facts(0).force_n == 0.0
    assert not frame.truth.contact.any()
    free = (first.truth.depth_m > 0.0) & (np.abs(first.truth.depth_m - frame.truth.depth_m) < 0.0002)
    assert free.any()
    assert not np.array_equal(first.tactile_color, frame.tactile_color)


def test_high_presses_stretch_to_twice_the_length_and_sides_are_turned_images():
    right, left = (open_coarse("cup", press="high", side=side).facts(0) for side in ("right", "left"))
    assert 0.6 < right.strain_length < 1.5
    assert left.strain_length == pytest.approx(right.strain_length, abs=0.02)
    assert left.force_n == pytest.approx(right.force_n, rel=0.01)
    middle = 0.020
    a, b = (np.array(facts.T_proximity_object)[:2, 3] for facts in (right, left))
    assert a + b == pytest.approx([2 * middle, 0.0], abs=1e-9)
    assert a[0] - b[0] > 0.1


@pytest.mark.parametrize("gap_mm", [1.0, 20.0])
def test_hovering_object_keeps_its_gap(gap_mm):
    with open_coarse("hover", object="cube", gap_mm=gap_mm) as source:
        frame = source.read(0)
        assert source.facts(0).depth_m == pytest.approx(-gap_mm / 1e3)
        assert not frame.truth.contact.any()
        behind = frame.proximity_depth * 0.00025 - frame.truth.depth_m
        assert np.nanquantile(behind[frame.truth.depth_m > 0], 0.0005) == pytest.approx(gap_mm / 1e3, abs=1.5e-3)


@pytest.mark.parametrize("shape", HELD_OUT)
def test_held_out_shapes_say_so_and_press(shape):
    with open_coarse(shape, press="medium") as source:
        assert source.held_out
        assert source.read(0).truth.contact.sum() > 500
        assert source.facts(0).residual < 1e-3
    assert not resolve_scene("cube").pressed.held_out


def test_light_changes_colours_only():
    normal, dim, bright = (
        open_coarse("cup", press="medium", light=light).read(0) for light in ("normal", "dim", "bright")
    )
    assert dim.proximity_color.mean() < 0.75 * normal.proximity_color.mean()
    assert bright.proximity_color.mean() > 1.15 * normal.proximity_color.mean()
    assert np.array_equal(dim.proximity_depth, normal.proximity_depth)
    assert light_table("normal") is None


@pytest.mark.parametrize(
    ("shape", "press"),
    [
        ("cup", "medium"),
        pytest.param("cube", "low", marks=pytest.mark.long),
        pytest.param("cube", "high", marks=pytest.mark.long),
    ],
)
@pytest.mark.parametrize("membrane", MEMBRANES)
def test_every_membrane_is_solved_and_has_its_rim_at_the_same_place(membrane, shape, press):
    design = MEMBRANES[membrane].design
    with open_coarse(shape, press="none", membrane=membrane) as source:
        frame, rest = source.read(0), source.facts(0)
        assert np.nanmax(frame.truth.depth_m) == pytest.approx(RIM_M + design.apex_m, abs=2e-4)
        assert rest.residual < 1e-3
        assert source.held_out is MEMBRANES[membrane].held_out
        assert ("membrane=" in source.name) is (membrane != STANDARD)
    with open_coarse(shape, press=press, membrane=membrane) as source:
        facts = source.facts(0)
        assert facts.residual < 1e-3
        assert facts.force_n > 0.5
        assert 0.1 < facts.max_strain < 3.0
        assert facts.gauge_pressure_pa > rest.gauge_pressure_pa
        assert source.read(0).truth.contact.sum() > 300
        with source.with_object_away() as away:
            assert away.scene.design == source.scene.design


@pytest.fixture(scope="module")
def tray():
    return open_coarse("tray")


def true_roll_deg(pose):
    return np.degrees(np.arcsin(-np.array(pose)[1, 2]))


def test_books_roll_the_tray_until_the_membrane_s_torque_balances_them(tray):
    rate = tray.frame_rate_hz
    assert tray.length == round(SECONDS * rate)
    for n, book in enumerate(BOOKS):
        facts = tray.facts(round((book.time_s + 2.9) * rate))
        roll = np.radians(true_roll_deg(facts.T_proximity_object))
        load = -0.6 * 0.008 * np.sin(roll)  # of the tray itself
        load += sum(each.mass_kg * (each.y_m * np.cos(roll) - 0.030 * np.sin(roll)) for each in BOOKS[: n + 1])
        assert facts.torque_nm[0] == pytest.approx(9.81 * load, rel=0.02)
        assert np.sign(roll) == -np.sign(load)
    assert abs(true_roll_deg(tray.facts(round(2.9 * rate)).T_proximity_object)) < 0.1


def test_the_tray_s_underside_is_its_plane(tray):
    index = round(5.9 * tray.frame_rate_hz)
    frame, pose = tray.read(index), np.array(tray.facts(index).T_proximity_object)
    points = tray.rig.proximity.intrinsics.rays()[frame.truth.contact]
    points = np.column_stack([points, np.ones(len(points))]) * frame.truth.depth_m[frame.truth.contact][:, None]
    off = (points - pose[:3, 3]) @ pose[:3, 2]
    assert len(points) > 10_000  # some on the round edges
    assert np.median(np.abs(off)) < 0.00003


def test_a_roll_between_two_solved_ones_is_as_if_it_were_solved(tray):
    """From states one degree apart; the scene's own are half a degree apart."""
    key = f"{tray.scene.key} {tray.rig.model_dump_json()}"
    states = find_solved(cache_file(tray.scene.name, key), len(tray.scene.drawn)).states
    direct, between = states[20], state_between([states[19], states[21]], 0.5)
    for name in ("membrane", "tactile", "behind"):
        off = np.abs(getattr(between, name).astype(float) - getattr(direct, name)) * CLEAN_UNIT_M
        assert np.quantile(off, 0.99) < 0.0001
    wrong = ((direct.flags ^ between.flags) & CONTACT_FLAG).sum()
    assert wrong < 0.05 * (direct.flags & CONTACT_FLAG).sum()
    assert not np.array_equal(states[20].tactile, states[19].tactile)
