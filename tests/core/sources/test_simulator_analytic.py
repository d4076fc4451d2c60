"""The simulated membrane against cases with analytic solutions."""

from __future__ import annotations

import numpy as np
import pytest

from tactune.core.sources.simulator.membrane import ATMOSPHERE_PA, Membrane, contact_share, object_pose
from tactune.core.sources.simulator.mesh import MembraneDesign
from tactune.core.sources.simulator.objects import BALL, BALL_RADIUS_M


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


def contact_area_m2(cells, depth_m=0.012):
    """Area of the deformed sheet that a ball touches."""
    membrane = Membrane(MembraneDesign(cells=cells))
    apex = membrane.design.apex_m
    nodes = None
    for depth in (depth_m / 2, depth_m):
        pose = object_pose(np.eye(3), (0.0, 0.0, apex + BALL_RADIUS_M - depth))
        state = membrane.press(BALL, pose, nodes)
        nodes = state.nodes
    corners = nodes[membrane.mesh.triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    touching = contact_share(membrane, state, BALL, pose)[membrane.mesh.triangles].mean(axis=1)
    return float((areas * touching).sum()), state


@pytest.mark.parametrize("cells", [(44, 26), pytest.param((176, 104), marks=pytest.mark.long)])
def test_ball_s_contact_area_and_force_hardly_depend_on_the_mesh(cells):
    (area, state), (middle, middle_state) = contact_area_m2(cells), contact_area_m2((88, 52))
    assert area == pytest.approx(middle, rel=0.02)
    assert state.reaction_n.sum() == pytest.approx(middle_state.reaction_n.sum(), rel=0.02)
