"""Centroids of dots on a curved sheet next to a depth step, against dots printed on the flat sheet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import pytest

from tactune.core.evaluation.strain import dots
from tactune.core.evaluation.strain.dots import centroids_on_bends, find_dots
from tactune.core.evaluation.strain.surface import SeenSurface
from tactune.core.model.intrinsics import Intrinsics

LENS = Intrinsics(width=200, height=96, fx=386.0, fy=386.0, cx=99.5, cy=47.5)
NEAR_M, FAR_M, DOT_M = 0.25, 0.33, 0.0022
BRIGHT, BACKGROUND, INK = 190.0, 110.0, 0.65
#: How the sheet folds: angle in degrees, radius and what hangs down behind, metres; and how much darker 90 degrees is.
ROUND, SHARP = (60.0, 0.002, 0.004, 0.3), (60.0, 0.0005, 0.004, 0.3)
#: Across the fold, metres.
STEP_M = 0.0174
_FINE = 6


@dataclass(frozen=True)
class Scene:
    """A rendered sheet. ``true``: pixels of the printed centroids; ``shown``: centroids of the visible parts."""

    depth_m: npt.NDArray[np.float64]
    gray: npt.NDArray[np.uint8]
    true: npt.NDArray[np.float64]
    shown: npt.NDArray[np.float64]
    lens: Intrinsics

    @property
    def surface(self):
        return SeenSurface.of(self.depth_m, self.lens)


def render(places, fold=ROUND, *, shift=(0.0, 0.0), inks=None, noise_m=1e-4, roll=0.0, lens=LENS):
    """Render discs at places on the sheet, metres across and along it from where the fold begins.

    The sheet moves by ``shift`` pixels, and the camera is rolled by degrees. Everything is where it is by the length
    along the folded profile, so that nothing here is taken from the code that is tested.
    """
    degrees, radius, flap, dark = fold
    end = np.radians(degrees)
    s = np.linspace(-0.05, radius * end + flap, 20001)
    angle, step = np.clip(s / radius, 0.0, end), np.diff(s, prepend=s[0])
    y, z = np.cumsum(np.cos(angle) * step), np.cumsum(np.sin(angle) * step)
    start = np.searchsorted(s, 0.0)
    y, z = y - y[start] + shift[1] * NEAR_M / lens.fy, z - z[start] + NEAR_M
    v_of = lens.cy + lens.fy * y / z
    places = np.add(places, (shift[0] * NEAR_M / lens.fx, 0.0))
    inks = np.full(len(places), INK) if inks is None else np.asarray(inks)

    def rolled(u, v, back=1.0):
        cos, sin = np.cos(np.radians(roll)), back * np.sin(np.radians(roll))
        right, down = u - lens.cx, v - lens.cy
        return lens.cx + cos * right + sin * down, lens.cy - sin * right + cos * down

    def look(u, v):
        u, v = rolled(u, v)
        seen = v <= v_of[-1]
        depth = np.where(seen, np.interp(v, v_of, z), FAR_M)
        x, along, down = (u - lens.cx) / lens.fx * depth, np.interp(v, v_of, s), (v - lens.cy) / lens.fy
        normal = np.interp(v, v_of, angle)
        cosine = (np.cos(normal) - down * np.sin(normal)) / np.hypot(1.0, down)
        inside = np.array([seen & (np.hypot(x - place[0], along - place[1]) < DOT_M) for place in places])
        light = np.where(seen, BRIGHT * (1.0 - dark + dark * cosine), BACKGROUND)
        return depth, light * (1.0 - inks @ inside.reshape(len(places), -1)).reshape(x.shape), inside

    v, u = np.indices(lens.shape).astype(float)
    parts = [((i + 0.5) / _FINE - 0.5, (j + 0.5) / _FINE - 0.5) for i in range(_FINE) for j in range(_FINE)]
    looks = [look(u + du, v + dv)[1:] for du, dv in parts]
    gray = np.rint(np.mean([light for light, _ in looks], axis=0)).astype(np.uint8)
    cover = np.mean([inside for _, inside in looks], axis=0)
    shown = np.array([((part * u).sum(), (part * v).sum()) / part.sum() for part in cover])
    depth = look(u, v)[0] + np.random.default_rng(0).normal(0.0, noise_m, u.shape)
    x, along = places.T
    at = rolled(lens.cx + lens.fx * x / np.interp(along, s, z), np.interp(along, s, v_of), -1.0)
    true = np.column_stack(at)
    return Scene(depth, gray, true, shown, lens)


def turned(scene, way):
    """Turn a scene such that the sheet folds away downwards, upwards, to the right or to the left."""
    depth, gray, true, shown, lens = scene.depth_m, scene.gray, scene.true, scene.shown, scene.lens
    if way in ("up", "left"):
        depth, gray = depth[::-1], gray[::-1]
        true, shown = (np.column_stack([at[:, 0], lens.height - 1 - at[:, 1]]) for at in (true, shown))
    if way in ("right", "left"):
        depth, gray, true, shown = depth.T, gray.T, true[:, ::-1], shown[:, ::-1]
        lens = lens.model_copy(update={"width": 96, "height": 200, "cx": lens.cy, "cy": lens.cx})
    return Scene(np.ascontiguousarray(depth), np.ascontiguousarray(gray), true, shown, lens)


def off(spots, places):
    """Return how far the nearest spot is from each place, pixels."""
    return np.hypot(*(spots.pixels[None] - places[:, None]).transpose(2, 0, 1)).min(axis=1)


@pytest.fixture
def unrefined(monkeypatch):
    """Return `find_dots` as it is without the closer look at bends."""

    def leave(surface, gray, labels, numbers, pixels, ink):
        return pixels.copy(), np.ones(len(pixels), bool)

    def find(*words):
        with monkeypatch.context() as patch:
            patch.setattr(dots, "centroids_on_bends", leave)
            return find_dots(*words)

    return find


def across(*along):
    """Return places side by side, and each so far along the sheet."""
    return [((number - (len(along) - 1) / 2) * STEP_M, at) for number, at in enumerate(along)]


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.3, 0.25), (0.6, 0.5), (0.15, 0.75)])
@pytest.mark.parametrize("way", ["down", "up", "right", "left"])
@pytest.mark.parametrize("fold, along", [(ROUND, (0.0006, 0.0013, 0.0021)), (SHARP, (-0.0001, 0.0009, 0.0013))])
def test_a_centroid_on_a_bend_is_that_of_what_is_printed(fold, along, way, shift, unrefined):
    scene = turned(render(across(*along, *along), fold, shift=shift), way)
    assert (off(find_dots(scene.gray, 21, scene.surface), scene.true) < 0.15).all()
    assert (np.hypot(*(scene.shown - scene.true).T) > 0.3).all()  # the centroids of what the picture shows
    assert off(unrefined(scene.gray, 21, scene.surface), scene.true).max() > 0.3


@pytest.mark.parametrize("roll", [-40.0, 30.0, 130.0, 200.0])
def test_the_bend_may_run_across_the_pixels(roll, unrefined):
    lens = Intrinsics(width=150, height=150, fx=386.0, fy=386.0, cx=74.5, cy=74.5)
    scene = render(across(0.0009, 0.0013, 0.0017, 0.0021), roll=roll, lens=lens)
    assert off(find_dots(scene.gray, 21, scene.surface), scene.true).max() < 0.15
    assert np.hypot(*(scene.shown - scene.true).T).min() > 0.3
    assert off(unrefined(scene.gray, 21, scene.surface), scene.true).max() > 0.3


def test_a_dot_may_reach_to_where_the_sheet_is_seen_last():
    """Less than half a pixel is between its end and the step."""
    fold = (60.0, 0.004, 0.001, 0.3)
    length = fold[1] * np.pi / 3 + fold[2]
    for shift in (0.0, 0.25, 0.5, 0.75):
        scene = render(across(*(length - DOT_M - np.array([0.0003, 0.0005, 0.0006]))), fold, shift=(0.3, shift))
        assert off(find_dots(scene.gray, 21, scene.surface), scene.true).max() < 0.15


def test_shade_is_told_from_print(unrefined):
    """The sheet turns away from the light, too: it is 0.7 as bright where it is steep."""
    errors = []
    for dark in (0.0, 0.6):
        scene = render(across(0.0013, 0.0017, 0.0021), (*ROUND[:3], dark))
        assert off(find_dots(scene.gray, 21, scene.surface), scene.true).max() < 0.12
        errors.append(off(unrefined(scene.gray, 21, scene.surface), scene.true).max())
    assert errors[1] > errors[0] + 0.1


def test_dots_far_from_steps_stay_where_they_are(unrefined):
    """The same sheet far from its fold, where a faint dot is one."""
    scene = render([*across(-0.015, 0.0013, -0.018, 0.0021), (0.0, -0.022)], inks=[INK] * 4 + [0.3])
    moved, before = find_dots(scene.gray, 21, scene.surface), unrefined(scene.gray, 21, scene.surface)
    assert len(moved) == len(before) == 5
    far = before.pixels[:, 1] < 40
    assert np.count_nonzero(far) == 3
    assert (moved.pixels[far] == before.pixels[far]).all()
    assert (np.abs(moved.pixels[~far] - before.pixels[~far]).max(axis=1) > 0.1).all()
    for one in ("area_m2", "at_step"):
        assert (getattr(moved, one) == getattr(before, one)).all()


@pytest.mark.parametrize("along", [0.0009, 0.0025])
@pytest.mark.parametrize("way", ["down", "left"])
def test_a_shadow_beside_a_step_is_no_dot(along, way, unrefined):
    places = across(-0.015, -0.015, -0.015, 0.0013, along, -0.015, 0.0013)
    found = []
    for ink in (0.25, INK):
        scene = turned(render(places, inks=[INK] * 4 + [ink] + [INK] * 2), way)
        assert len(unrefined(scene.gray, 21, scene.surface)) == len(places)
        found.append(off(find_dots(scene.gray, 21, scene.surface), scene.true) < 0.5)
    assert (~found[0]).nonzero()[0].tolist() == [4]
    assert found[1].all()


@pytest.fixture(scope="module")
def one_dot():
    """Return a dot beside a step: its scene, labels, and the approximate centre."""
    scene = render([(0.0, 0.0013)])
    u, v = np.rint(scene.shown[0]).astype(int)
    labels = np.zeros(scene.gray.shape, np.int32)
    labels[v - 2 : v + 3, u - 3 : u + 4] = 1
    return scene, labels, scene.shown


def look(depth_m, scene, labels, pixels, ink=INK):
    surface = SeenSurface.of(depth_m, scene.lens)
    near = surface.near_step(8)[tuple(np.rint(pixels[0, ::-1]).astype(int))]
    centroids, printed = centroids_on_bends(surface, scene.gray, labels, np.array([1]), pixels, ink)
    return near, centroids, printed.all()


def test_only_the_requested_centroid_moves_and_no_array_is_changed(one_dot):
    scene, labels, pixels = one_dot
    arrays = [scene.depth_m, scene.gray, labels, pixels]
    copies = [array.copy() for array in arrays]
    near, centroids, printed = look(scene.depth_m, scene, labels, pixels)
    assert near and printed
    assert np.hypot(*(centroids - scene.true)[0]) < 0.15 < np.hypot(*(pixels - scene.true)[0])
    assert all((array == copy).all() for array, copy in zip(arrays, copies, strict=True))
    assert not look(scene.depth_m, scene, labels, pixels, ink=3.0)[2]  # by far not as dark as others


def test_a_spot_without_bare_surface_around_stays_where_it_is(one_dot):
    """As between spots that nearly touch it."""
    scene, labels, pixels = one_dot
    crowded = np.where(labels == 0, 2, labels)
    near, centroids, printed = look(scene.depth_m, scene, crowded, pixels, ink=3.0)
    assert near and printed and (centroids == pixels).all()


@pytest.mark.parametrize("around_px", [0, 1, 2])
def test_a_spot_without_depth_around_stays_where_it_is(one_dot, around_px):
    """Down to a spot without any depth, with a step near it."""
    scene, labels, pixels = one_dot
    depth = scene.depth_m.copy()
    v, u = np.indices(depth.shape)
    away = np.maximum(np.abs(u - pixels[0, 0]) - 3, np.abs(v - pixels[0, 1]) - 2)
    depth[(away >= around_px - 0.5) & (away < 4.5)] = np.nan
    if around_px == 0:
        depth[labels > 0] = np.nan
    near, centroids, printed = look(depth, scene, labels, pixels)
    assert near and printed and (centroids == pixels).all()


def test_a_hole_in_the_depth_of_a_dot_changes_little():
    """Stereo matching finds nothing in dark dots."""
    scene = render([*across(0.0009, 0.0013, 0.0017, 0.0021), (0.0, 0.0011)], inks=[INK] * 4 + [0.25])
    depth = scene.depth_m.copy()
    u, v = np.rint(scene.shown).astype(int).T
    depth[v, u] = depth[v, u + 1] = np.nan
    found = off(find_dots(scene.gray, 21, SeenSurface.of(depth, scene.lens)), scene.true)
    assert (found[:4] < 0.15).all()
    assert found[4] > 1.0  # a shadow


@pytest.mark.parametrize("corner", [(0, 0), (0, -1), (-1, 0), (-1, -1)])
def test_a_spot_in_a_corner_of_the_image_is_no_mistake(one_dot, corner):
    scene, _, _ = one_dot
    rows, columns = scene.gray.shape
    v, u = corner[0] % rows, corner[1] % columns
    labels = np.zeros(scene.gray.shape, np.int32)
    labels[v, u] = 1
    depth = np.full(scene.gray.shape, FAR_M)
    depth[max(v - 4, 0) : v + 5, max(u - 4, 0) : u + 5] = NEAR_M
    near, centroids, _ = look(depth, scene, labels, np.array([(u, v)], float))
    assert near and np.isfinite(centroids).all() and np.abs(centroids - (u, v)).max() <= 1.0
