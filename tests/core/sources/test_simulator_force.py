"""The simulator's contact force and pressure, checked by the balance of the whole sheet and by an analytic case."""

import numpy as np
import pytest
from scipy.optimize import brentq

from tactune.core import open_source
from tactune.core.sources.simulator.membrane import (
    ATMOSPHERE_PA,
    Membrane,
    MembraneDesign,
    contact_load,
    contact_share,
    object_pose,
)
from tactune.core.sources.simulator.objects import BALL, BALL_RADIUS_M, CUP
from tactune.core.sources.simulator.render import node_areas

#: Conformal radius of a square at its centre, as a share of its side: where a point load sees a circular rim.
CONFORMAL = 1.0787 / 2


def press(membrane, kind, heights_m):
    nodes = None
    for height_m in heights_m:
        pose = object_pose(np.eye(3), (0.0, 0.0, height_m))
        state = membrane.press(kind, pose, nodes)
        nodes = state.nodes
    return pose, state


def tension(mesh, design, nodes):
    """Return each triangle's force on its corners, (T, 3, 3), by the second Piola-Kirchhoff stress of Yeoh's rubber."""
    flat, now = mesh.flat[mesh.triangles, :2] / design.prestretch, nodes[mesh.triangles]
    edges = np.stack([flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]], 2)
    inverse = np.linalg.inv(edges)
    deformation = np.stack([now[:, 1] - now[:, 0], now[:, 2] - now[:, 0]], 2) @ inverse
    right = np.einsum("tki,tkj->tij", deformation, deformation)
    det = np.linalg.det(right)
    slope = 1 + 2 * design.stiffening * (np.trace(right, axis1=1, axis2=2) + 1 / det - 3)
    stress = (np.eye(2) - np.linalg.inv(right) / det[:, None, None]) * (mesh.stiffness * slope)[:, None, None]
    pull = deformation @ stress @ np.swapaxes(inverse, 1, 2)  # (T, 3, 2): on the second and the third corner
    return -np.stack([-pull.sum(2), pull[:, :, 0], pull[:, :, 1]], 1)


def test_the_force_is_the_pressure_on_the_rims_area_less_the_pull_at_the_rim():
    design = MembraneDesign(cells=(60, 36))
    membrane = Membrane(design)
    _, state = press(membrane, CUP, np.arange(0.096, 0.06, -0.004))
    force = contact_load(membrane, state).sum(axis=0)
    pulls = np.zeros_like(state.nodes)
    np.add.at(pulls, membrane.mesh.triangles, tension(membrane.mesh, design, state.nodes))
    at_rim = pulls[~membrane.mesh.free].sum(axis=0)  # of the sheet on its clamp
    gauge = state.pressure_pa - ATMOSPHERE_PA
    at_rim += gauge * node_areas(state.nodes, membrane.mesh.triangles)[~membrane.mesh.free].sum(axis=0)
    lift = np.array([0.0, 0.0, gauge * design.width_m * design.height_m])
    assert np.linalg.norm(force) > 10.0
    assert np.linalg.norm(force + lift - at_rim) < 0.02 * np.linalg.norm(force)


def test_a_ball_in_a_flat_taut_sheet_has_the_force_and_contact_of_a_surface_of_constant_tension():
    side = 0.10
    design = MembraneDesign(
        width_m=side, height_m=side, apex_m=0.0001, prestretch=1.6, stiffening=0.0, dead_volume_m3=10.0, cells=(90, 90)
    )
    membrane = Membrane(design)  # in so much air that its pressure stays next to nothing
    depth = 0.0045  # past the flat sheet
    pose, state = press(membrane, BALL, BALL_RADIUS_M - np.linspace(0.0005, depth, 4))
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
