"""The membrane's contact problem and its force, checked by independent conditions and analytic cases."""

import numpy as np
import pytest
from scipy.optimize import brentq

from tactune.core import open_source
from tactune.core.sources.simulator.membrane import (
    ATMOSPHERE_PA,
    TOUCH_GAP_M,
    Membrane,
    MembraneDesign,
    contact_load,
    contact_share,
    object_pose,
)
from tactune.core.sources.simulator.objects import BALL, BALL_RADIUS_M, OBJECTS, distance, normal, turn
from tactune.core.sources.simulator.scene import Press, simulator_rig
from tactune.core.sources.simulator.scenes import Variant, resolve_scene

COARSE = MembraneDesign(cells=(36, 20))


@pytest.fixture(scope="module")
def membrane():
    return Membrane(COARSE)


def press(membrane, name, depth_m, offset_m=None, rotation=None, step_m=0.004):
    """Press an object from above the apex to a depth, in steps; return pose and equilibrium."""
    pressed = OBJECTS[name]
    rotation = turn(pressed.rotation_deg) if rotation is None else rotation
    offset = pressed.offset_m if offset_m is None else offset_m
    touch = membrane.design.apex_m + 0.2
    for _ in range(100):
        pose = object_pose(rotation, (*offset, touch))
        touch -= min(distance(pressed.kind, pose, *node) for node in membrane.rest.nodes)
    nodes = None
    for depth in np.linspace(0, depth_m, int(np.ceil(depth_m / step_m)) + 1)[1:]:
        pose = object_pose(rotation, (*offset, touch - depth))
        state = membrane.press(pressed.kind, pose, nodes)
        nodes = state.nodes
    return pose, state


@pytest.fixture(scope="module", params=["cube", "cup", "octopus"])
def pressed(request, membrane):
    return request.param, *press(membrane, request.param, 0.024)


def volume_over_rim(mesh, nodes):
    """Volume under the sheet as a sum of prisms: mean height times projected area."""
    corners = nodes[mesh.triangles]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return float(np.sum(corners[:, :, 2].mean(1) * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2))


def energy(membrane, nodes):
    """Yeoh's rubber, isothermal air and the atmosphere, in joules, written from the formulas."""
    design, mesh = membrane.design, membrane.mesh
    unstretched = mesh.flat[:, :2] / design.prestretch
    before, now = unstretched[mesh.triangles], nodes[mesh.triangles]
    b0, b1 = before[:, 1] - before[:, 0], before[:, 2] - before[:, 0]
    area = np.abs(b0[:, 0] * b1[:, 1] - b0[:, 1] * b1[:, 0]) / 2
    edges = np.stack([now[:, 1] - now[:, 0], now[:, 2] - now[:, 0]], 2)
    deformation = edges @ np.linalg.inv(np.stack([b0, b1], 2))
    right = np.einsum("tki,tkj->tij", deformation, deformation)
    strain = np.trace(right, axis1=1, axis2=2) + 1 / np.linalg.det(right) - 3
    density = 0.5 * design.stiffness_n_m * (strain + design.stiffening * strain**2)
    volume = volume_over_rim(mesh, nodes) + design.dead_volume_m3
    amount = membrane.rest.pressure_pa * (volume_over_rim(mesh, membrane.rest.nodes) + design.dead_volume_m3)
    return float(np.sum(area * density) - amount * np.log(volume) + ATMOSPHERE_PA * volume)


def test_inflated_apex_has_its_height(membrane):
    assert membrane.rest.nodes[:, 2].max() == pytest.approx(COARSE.apex_m, abs=1e-6)
    assert np.array_equal(membrane.rest.nodes[~membrane.mesh.free], membrane.mesh.flat[~membrane.mesh.free])
    assert membrane.rest.pressure_pa > ATMOSPHERE_PA


def test_object_is_not_penetrated_and_pushes_only_where_it_touches(pressed):
    name, pose, state = pressed
    gaps = np.array([distance(OBJECTS[name].kind, pose, *node) for node in state.nodes])
    assert gaps.min() > -1e-9
    assert (state.reaction_n >= 0).all()
    assert np.count_nonzero(state.reaction_n) >= 5
    assert gaps[state.reaction_n > 0].max() <= TOUCH_GAP_M


def test_air_is_conserved_and_bulges_elsewhere(membrane, pressed):
    _, _, state = pressed
    rest = membrane.rest
    volume, at_rest = (volume_over_rim(membrane.mesh, s.nodes) + COARSE.dead_volume_m3 for s in (state, rest))
    assert volume < 0.997 * at_rest
    assert state.pressure_pa * volume == pytest.approx(rest.pressure_pa * at_rest, rel=1e-9)
    far = np.abs(membrane.mesh.flat[:, 0]) > 0.12
    assert (state.nodes - rest.nodes)[far & membrane.mesh.free, 2].min() > 0


def test_forces_balance(membrane, pressed):
    """The energy's slope along any motion equals the work of the contact reactions."""
    name, pose, state = pressed
    kind = OBJECTS[name].kind
    push = np.zeros_like(state.nodes)
    for n in np.flatnonzero(state.reaction_n):
        push[n] = state.reaction_n[n] * np.array(normal(kind, pose, *state.nodes[n]))
    gauge = state.pressure_pa - ATMOSPHERE_PA
    nodal_force = gauge * COARSE.width_m * COARSE.height_m / len(state.nodes)
    rng = np.random.default_rng(3)
    for _ in range(5):
        motion = rng.standard_normal(state.nodes.shape) * membrane.mesh.free[:, None]
        step = 1e-7
        slope = (energy(membrane, state.nodes + step * motion) - energy(membrane, state.nodes - step * motion)) / (
            2 * step
        )
        assert slope == pytest.approx(np.sum(push * motion), abs=3e-3 * nodal_force * np.sqrt(motion.size))
    assert np.sum(push[:, 2]) < -5.0


@pytest.mark.parametrize("name", sorted(OBJECTS))
def test_distance_is_a_bound_and_agrees_with_its_normal(name):
    kind = OBJECTS[name].kind
    pose = object_pose(np.eye(3), np.zeros(3))
    points = np.random.default_rng(5).uniform(-0.09, 0.09, (4000, 3))
    values = np.array([distance(kind, pose, *point) for point in points])
    steps = np.random.default_rng(6).uniform(-0.003, 0.003, points.shape)
    moved = np.array([distance(kind, pose, *point) for point in points + steps])
    near = np.linalg.norm(points, axis=1) < 0.095
    assert (np.abs(moved - values) <= np.linalg.norm(steps, axis=1) * 1.001)[near].all()
    for point, value in zip(points[:200], values[:200], strict=True):
        if 0.0005 < value < 0.01:
            surface = point - value * np.array(normal(kind, pose, *point))
            assert abs(distance(kind, pose, *surface)) < 0.6 * value


# Analytic solutions


def taut_sheet_height(x, y, width, height, pressure_over_tension, terms=61):
    """Height of a taut sheet over a rectangle under pressure: the solution of -T laplace(w) = p, as a sine series."""
    w = np.zeros(np.broadcast(x, y).shape)
    for m in range(1, terms, 2):
        for n in range(1, terms, 2):
            scale = 16 / (np.pi**4 * m * n * ((m / width) ** 2 + (n / height) ** 2))
            w += scale * np.sin(m * np.pi * (x / width + 0.5)) * np.sin(n * np.pi * (y / height + 0.5))
    return pressure_over_tension * w


def test_slightly_inflated_sheet_is_the_taut_sheet_of_the_textbook():
    design = MembraneDesign(cells=(60, 36), apex_m=0.0015, prestretch=1.25, dead_volume_m3=0.002)
    membrane = Membrane(design, tolerance=1e-4)
    s = design.prestretch
    strain = 2 * s**2 + s**-4 - 3
    tension = design.stiffness_n_m * (1 - s**-6) * (1 + 2 * design.stiffening * strain)
    gauge = membrane.rest.pressure_pa - ATMOSPHERE_PA
    x, y = membrane.mesh.flat[:, 0], membrane.mesh.flat[:, 1]
    expected = taut_sheet_height(x, y, design.width_m, design.height_m, gauge / tension)
    assert expected.max() == pytest.approx(design.apex_m, rel=0.01)
    assert np.abs(membrane.rest.nodes[:, 2] - expected).max() < 0.01 * design.apex_m


#: Conformal radius of a square at its centre, as a share of its side: where a point load sees a circular rim.
CONFORMAL = 1.0787 / 2


def lower(membrane, kind, heights_m):
    nodes = None
    for height_m in heights_m:
        pose = object_pose(np.eye(3), (0.0, 0.0, height_m))
        state = membrane.press(kind, pose, nodes)
        nodes = state.nodes
    return pose, state


def test_a_ball_in_a_flat_taut_sheet_has_the_force_and_contact_of_a_surface_of_constant_tension():
    side = 0.10
    design = MembraneDesign(
        width_m=side, height_m=side, apex_m=0.0001, prestretch=1.6, stiffening=0.0, dead_volume_m3=10.0, cells=(90, 90)
    )
    membrane = Membrane(design)  # in so much air that its pressure stays next to nothing
    depth = 0.0045  # past the flat sheet
    pose, state = lower(membrane, BALL, BALL_RADIUS_M - np.linspace(0.0005, depth, 4))
    force = -contact_load(membrane, state).sum(axis=0)[2]
    share = contact_share(membrane, state, BALL, pose)
    flat_area = side * side / len(share)
    radius = np.sqrt(flat_area * share.sum() / np.pi)

    # r sin(slope) = c outside of contact, and a slope a / R at its edge: a surface of revolution without pressure
    def sunk(a):
        c = a * a / BALL_RADIUS_M
        return BALL_RADIUS_M - np.sqrt(BALL_RADIUS_M**2 - a * a) + c * (
            np.arccosh(CONFORMAL * side / c) - np.arccosh(a / c)
        )  # fmt: skip

    a = brentq(lambda a: sunk(a) - depth, 1e-3, 0.03)
    taut = design.stiffness_n_m * (1 - design.prestretch**-6)  # of neo-Hookean rubber, per present length
    assert radius == pytest.approx(a, abs=1e-3)
    assert force == pytest.approx(2 * np.pi * taut * a * a / BALL_RADIUS_M, rel=0.05)


def test_a_node_that_sticks_and_comes_off_in_turn_slides_until_all_is_in_balance():
    scene = resolve_scene("cup", Variant(press="high", membrane="sticky"), (56, 32))
    *_, (_, _, state) = Press(scene, Membrane(scene.design), simulator_rig()).states()
    assert state.residual < 1e-3


def test_a_frames_truth_holds_force_and_pressure_in_its_own_camera():
    with open_source("sim:cup?press=medium") as source, open_source("sim:cup?press=medium&cameras=tactile") as single:
        both, one = source.next_frame().truth, single.next_frame().truth
        pose = np.array(source.rig.T_proximity_tactile)
    assert pose[:3, :3] @ one.force_n == pytest.approx(both.force_n)
    assert both.force_n[2] < -10.0
    assert both.inflation_pa == one.inflation_pa > 1000.0
    for truth in (both, one):
        assert truth.pressure_pa[truth.contact].mean() > 0.5 * truth.inflation_pa
        assert (truth.pressure_pa[truth.contact] > 0).mean() > 0.95
