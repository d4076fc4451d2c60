"""The simulator's scenes: names, options, and their differences."""

import numpy as np
import pytest

from tactune.core.errors import SourceError
from tactune.core.sources.simulator.objects import turn
from tactune.core.sources.simulator.scene import RIM_M
from tactune.core.sources.simulator.scenes import (
    MEMBRANES,
    STANDARD,
    TRAY_ROLLS_DEG,
    Variant,
    read_name,
    resolve_scene,
    write_name,
)
from tactune.core.sources.simulator.source import SimulatorSource

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
    ],
)
def test_impossible_names_are_refused(name, words):
    with pytest.raises(SourceError, match=words):
        read_name(name)


def test_a_name_is_written_without_what_is_the_default():
    name = "octopus?press=high&side=left&membrane=soft&sensor=worn&seed=3&noise=0.5"
    assert write_name(**read_name(name)) == f"sim:{name}"
    assert write_name(**read_name("?press=&seed=0&noise=1")) == "sim:cup"


def test_high_presses_stretch_to_twice_the_length_and_sides_are_turned_images():
    right, left = (open_coarse("cup", press="high", side=side).facts(0) for side in ("right", "left"))
    assert 0.6 < right.strain.length < 1.5
    assert left.strain.length == pytest.approx(right.strain.length, abs=0.02)
    middle = 0.020
    a, b = (np.array(facts.T_proximity_object)[:2, 3] for facts in (right, left))
    assert a + b == pytest.approx([2 * middle, 0.0], abs=1e-9)
    assert a[0] - b[0] > 0.1


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


def on_object(source, frame, depth, pixels):
    """Points of some pixels of a depth image, metres, in the object's own frame."""
    points = np.dstack([source.rig.proximity.intrinsics.rays() * depth[..., None], depth])[pixels].astype(np.float64)
    pose = np.array(frame.truth.T_proximity_object)
    return (points - pose[:3, 3]) @ pose[:3, :3]


def test_the_tray_rolls_there_and_back_with_its_underside_as_its_plane():
    tray = SimulatorSource("tray", noise=0.0, sensor="datasheet")
    poses = [np.array(tray.facts(n).T_proximity_object) for n in range(tray.length)]
    rolls = np.degrees([np.arcsin(-pose[1, 2]) for pose in poses])
    assert rolls == pytest.approx([*TRAY_ROLLS_DEG, *TRAY_ROLLS_DEG[::-1]], abs=0.3)  # the camera is turned a little
    frame = tray.read(20)
    off = on_object(tray, frame, frame.truth.depth_m, frame.truth.contact)[:, 2]
    assert len(off) > 10_000  # some on the round edges
    assert np.median(np.abs(off)) < 0.00003


def test_the_cup_turns_about_its_handle_smoothly_for_five_seconds():
    scene = resolve_scene("cup", Variant(move="slide"))
    steps = [scene.way[scene.drawn[index]] for index in scene.frames]
    assert len(steps) == 5 * 30 and steps[::-1] == steps
    turns = np.array([turn(step.turn_deg) for step in steps])
    angles = np.degrees(np.arccos(np.clip((np.einsum("nji,nji->n", turns[:-1], turns[1:]) - 1) / 2, -1, 1)))
    places = np.array([step[:2] for step in steps])
    moved = np.linalg.norm(np.diff(places, axis=0), axis=1)
    assert 1.0 < angles.max() < 3.5 and 0.001 < moved.max() < 0.004
    assert np.abs(np.diff(moved)).max() < 0.0005 and moved[[0, -1]].max() < 0.0005
    handle = turns[:75] @ (0.043, 0.0, 0.0) + np.column_stack([places[:75], np.zeros(75)])
    across = (1 - np.cos(np.pi * np.linspace(0, 1, 75))) / 2
    assert np.abs((handle - handle[0])[:, 0] - 0.040 * across).max() < 0.001
