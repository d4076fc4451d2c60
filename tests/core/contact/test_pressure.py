"""The pressure test: contact and force from one camera, against the simulator's solver and a sphere."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.spatial import cKDTree

from rigs import rig_noise
from tactune.core import ContactPipeline, Preset, open_source
from tactune.core.contact.pressure import surface
from tactune.core.errors import RigMismatchError
from tactune.core.lab import table
from tactune.core.lab.single_camera import pressure as seen_alone
from tactune.core.lab.single_camera import tactile_only
from tactune.core.lab.table import measured_rig
from tactune.core.model.frames import Rig, SensorFrame, Shot
from tactune.core.model.metrics import pixel_scores, true_contact
from tactune.core.model.patch import Provenance
from tactune.core.output.writer import export_mcap
from tactune.core.rig.untouched import untouched_frame
from tactune.core.sources.folder import export_folder
from tactune.core.sources.simulator.objects import OBJECTS
from tactune.core.sources.simulator.scene import simulator_rig
from tactune.core.sources.simulator.scenes import Variant
from tactune.core.sources.simulator.simulator_source import SimulatorSource

PRESSURE = Preset(contact_test="pressure")


@pytest.fixture(scope="module", autouse=True)
def _few_frames():
    """Measure the noise of rigs in less time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(table, "NOISE_FRAMES", 20)
        yield


@pytest.fixture(scope="module")
def pressed():
    """The rig, the preset with its noise, a frame of a press, and the untouched frame."""
    with open_source("sim:cup?press=medium&cameras=tactile") as source:
        frame, untouched, preset = source.next_frame(), untouched_frame(source), measured_rig(PRESSURE, source)
    return source.rig, preset, frame, untouched


def bubble(rig, radius_m, apex_m=0.3, ball_m=1.0, contact_m=0.0, rim=False):
    """A membrane of constant tension on a round rim: free, a part of a sphere whose farthest point is at a depth.

    With a ball pressed into it: r sin(slope) = r^2 / ball_m where they touch, constant - r^2 / radius_m beyond.
    """
    lens, r = rig.tactile.intrinsics, radius_m * np.sin(np.linspace(1e-6, 1.4, 40_001))
    constant = contact_m**2 * (1 / ball_m + 1 / radius_m)
    sine = np.where(r < contact_m, r / ball_m, constant / r - r / radius_m)
    rise = cumulative_trapezoid(sine / np.sqrt(1 - sine**2), r, initial=0)
    depth = rise - rise[-1] + apex_m - radius_m + np.sqrt(radius_m**2 - r[-1] ** 2)
    v, u = np.mgrid[: lens.height, : lens.width]
    rays = np.hypot(*lens.normalise(np.stack([u, v], -1).reshape(-1, 2)).T).reshape(lens.shape)
    seen = np.interp(rays, r / depth, depth, right=depth[-1] if rim else 0)
    return SensorFrame.of_shots(rig, 0, None, Shot(np.rint(seen / 1e-4).astype(np.uint16), None, 0.0))


def test_a_sphere_has_its_curvature_and_carries_no_force():
    rig = Rig.of_one_camera(simulator_rig().tactile)
    counts = bubble(rig, 0.2).tactile_depth
    grid = surface.Grid.of(rig.tactile.intrinsics, counts)
    depth_m, share = surface.cells(counts, 1e-4, 0.0, grid)
    bulge, largest, _ = surface.curvature(surface.fit(depth_m, share, 2.0), grid)
    assert np.nanmedian(bulge) == pytest.approx(2 / 0.2, rel=0.01)
    assert np.nanmedian(largest) == pytest.approx(1 / 0.2, rel=0.02)
    assert np.nanstd(bulge) < 0.3
    steep_m, all_of_it = surface.cells(bubble(rig, 0.12).tactile_depth, 1e-4, 0.0, grid)
    steep = surface.curvature(surface.fit(steep_m, all_of_it, 2.0), grid)
    assert np.nanpercentile(steep[0], 95) == pytest.approx(2 / 0.12, rel=0.05), (
        "where it slopes in both directions, too"
    )
    rows, columns = np.mgrid[: depth_m.shape[0], : depth_m.shape[1]]
    weight = np.clip((22 - np.hypot(rows - 28, columns - 42)) / 8, 0, 1)
    air, pull, pressed = surface.balance(grid.points(depth_m), weight, np.full_like(weight, 0.5))
    assert air[2] > 0.003
    assert pressed == pytest.approx(air / 2)
    assert np.linalg.norm(air - pull * 0.2 / 2) < 0.01 * np.linalg.norm(air)


@pytest.mark.parametrize(("ball_m", "contact_m", "off_mm"), [(0.05, 0.015, 1), (0.05, 0.02, 1), (0.08, 0.03, 1)])
def test_a_ball_in_a_membrane_of_constant_tension_has_the_force_and_contact_of_the_integral(ball_m, contact_m, off_mm):
    rig, radius_m, gauge_pa = Rig.of_one_camera(simulator_rig().tactile), 0.25, 2000.0
    rest, now = bubble(rig, radius_m), bubble(rig, radius_m, 0.3, ball_m, contact_m)
    patch = ContactPipeline(PRESSURE.with_value("pressure.gauge_pa", gauge_pa), rig, rest).process(now)
    force_n = gauge_pa * np.pi * contact_m**2 * (1 + radius_m / ball_m)  # the air, and tension at the circle of contact
    assert patch.force_n == pytest.approx((0, 0, -force_n), abs=0.05 * force_n)
    assert np.sqrt(patch.area_mm2 / np.pi) == pytest.approx(1e3 * contact_m, abs=off_mm)
    # before any smoothing: the air on what lies inside of a ring, less the pull at the ring
    grid = surface.Grid.of(rig.tactile.intrinsics, now.tactile_depth)
    depth_m, _ = surface.cells(now.tactile_depth, 1e-4, 0.0, grid)
    weight = np.clip((0.07 - depth_m * np.hypot(grid.x, grid.y)) / 0.02, 0, 1)
    air, pull, _ = surface.balance(grid.points(depth_m), weight, np.zeros_like(weight))
    assert gauge_pa * (pull * radius_m / 2 - air) == pytest.approx((0, 0, -force_n), abs=0.02 * force_n)


def test_the_membrane_that_is_seen_past_a_deep_dent_is_no_contact():
    with open_source("sim:cup?press=high&side=right") as source:
        frame, untouched, preset = source.next_frame(), untouched_frame(source), measured_rig(PRESSURE, source)
    patch = seen_alone(preset, source.rig, untouched)(frame)
    away_m = cKDTree(true_contact(frame, source.rig)[0]).query(patch.points)[0]
    assert np.mean(away_m > 0.012) < 0.005


@pytest.mark.parametrize("radius_m", [0.1, 0.15, 0.25])  # a flat rim over most of the image; in its corners; none
def test_what_the_camera_sees_beside_the_membrane_changes_nothing(radius_m):
    rig, rim = Rig.of_one_camera(simulator_rig().tactile), radius_m < 0.2
    views = [[bubble(rig, radius_m, rim=it), bubble(rig, radius_m, 0.3, 0.05, 0.02, it)] for it in (False, rim)]
    for number, end in enumerate(() if rim else (90, 70)):  # past the rim, a corner that flickers, and specks
        counts = views[1][number].tactile_depth.copy()
        counts[:end, :end], counts[200:203, 40:43] = 15_000, 40_000
        views[1][number] = replace(views[1][number], tactile_depth=counts)
    alone, beside = (ContactPipeline(PRESSURE, rig, rest).process(now) for rest, now in views)
    assert beside.pressure.force_mm2 == pytest.approx(alone.pressure.force_mm2, rel=0.01, abs=1)
    assert beside.area_mm2 == pytest.approx(alone.area_mm2, rel=0.02)


@pytest.mark.parametrize(("radius_m", "contact_m"), [(0.15, 0.025), (0.15, 0.035), (0.1, 0.06)])  # half of it, too
@pytest.mark.parametrize(("counts", "stated_mm"), [(1, 4.3), (4, 4.8)])  # standard deviation of the noise
def test_a_flat_contact_is_as_wide_as_it_is_within_the_boundary_error_which_grows_with_noise(
    radius_m, contact_m, counts, stated_mm
):
    rig, off_mm, errors_mm = Rig.of_one_camera(simulator_rig().tactile), [], []
    rest, now = bubble(rig, radius_m, rim=True), bubble(rig, radius_m, 0.3, 1e3, contact_m, rim=True)
    known = rig_noise(correlated_m=1e-4 * counts, distance_m=np.median(rest.tactile_depth) * 1e-4)
    pipeline = ContactPipeline(PRESSURE.with_value("noise", known.model_dump()), rig, rest)
    for seed in range(4):
        noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=now.tactile_depth.shape), (0, 0), 4.0)
        noisy = np.rint(now.tactile_depth + counts * noise / noise.std()).astype(np.uint16)
        patch = pipeline.process(replace(now, tactile_depth=noisy))
        off_mm.append(abs(np.sqrt(patch.area_mm2 / np.pi) - 1e3 * contact_m))
        errors_mm.append(patch.doubt.boundary_error_mm)
    assert np.mean(off_mm) < min(np.mean(errors_mm), 4)
    assert np.mean(errors_mm) >= stated_mm


def test_force_and_contact_of_a_press_follow_the_solver(pressed):
    rig, preset, frame, untouched = pressed
    patch = ContactPipeline(preset.with_value("pressure.gauge_pa", frame.truth.inflation_pa), rig, untouched).process(
        frame
    )
    error_n = np.linalg.norm(np.subtract(patch.force_n, frame.truth.force_n))
    assert error_n < 0.10 * np.linalg.norm(frame.truth.force_n)
    assert (np.abs(np.subtract(patch.force_n, frame.truth.force_n)) < 4 * np.array(patch.pressure.force_sigma_n)).all()
    found = pixel_scores(patch.mask, frame.truth.contact).iou
    rival = pixel_scores(tactile_only(preset, rig, untouched)(frame).mask, frame.truth.contact).iou
    assert found > max(1.3 * rival, 0.45)
    assert patch.doubt.touch_probability > 0.9
    inside = patch.pressure_pa[patch.mask]
    assert np.nanmedian(inside) > 0.3 * frame.truth.inflation_pa
    assert (patch.provenance == Provenance.CONTACT).sum() == len(patch.points)


def test_without_the_inflation_figures_stay_relative_and_say_so(pressed):
    rig, preset, frame, untouched = pressed
    patch = ContactPipeline(preset, rig, untouched).process(frame)
    assert patch.force_n is None
    assert patch.pressure_pa is None
    record = json.loads(json.dumps(patch.pressure.record()))
    truth_mm2 = 1e6 * np.array(frame.truth.force_n) / frame.truth.inflation_pa
    assert record["relative_force_mm2"] == pytest.approx(truth_mm2.tolist(), abs=0.1 * np.linalg.norm(truth_mm2))
    assert record["force_n"] is record["inflation_pa"] is None


def test_unchanged_steps_are_skipped_and_a_larger_value_finds_less(pressed):
    rig, preset, frame, untouched = pressed
    pipeline = ContactPipeline(preset, rig, untouched)
    first = pipeline.process(frame)
    assert set(pipeline.process(frame).stage_ms.values()) == {0.0}
    pipeline.update(preset.with_value("pressure.share", 0.8))
    assert 0 < len(pipeline.process(frame).points) < len(first.points)
    pipeline.update(preset.with_value("pressure.limit", 20.0))
    assert not len(pipeline.process(frame).points)
    with pytest.raises(RigMismatchError, match="untouched frame"):
        ContactPipeline(preset, rig).process(frame)


def test_a_tactile_camera_that_lies_on_its_side_tells_the_same_force():
    with open_source("sim:cup?press=medium") as source:
        rig, frame, untouched, preset = source.rig, source.next_frame(), untouched_frame(source), PRESSURE
    lens, turn = rig.tactile.intrinsics, np.eye(4)
    turn[:2, :2] = (0.0, -1.0), (1.0, 0.0)
    turned = {"width": lens.height, "height": lens.width, "fx": lens.fy, "fy": lens.fx, "cx": lens.cy}
    camera = rig.tactile.model_copy(
        update={"intrinsics": lens.model_copy(update=turned | {"cy": lens.width - 1 - lens.cx})}
    )
    pose = (np.array(rig.T_proximity_tactile) @ turn).tolist()
    on_side = Rig(**dict(rig) | {"tactile": camera, "T_proximity_tactile": pose})

    def turned_frame(seen):
        depth = np.ascontiguousarray(np.rot90(seen.tactile_depth))
        return replace(seen, tactile_depth=depth, tactile_color=None, truth=None)

    usual = ContactPipeline(preset, rig, untouched).process(frame).pressure.force_mm2
    other = ContactPipeline(preset, on_side, turned_frame(untouched)).process(turned_frame(frame)).pressure.force_mm2
    assert other == pytest.approx(usual, abs=0.01 * np.linalg.norm(usual))
    assert np.hypot(*usual[:2]) > 0.02 * abs(usual[2]), "it is not only along the axis that both share"


def claimed(patch):
    """Whether a patch claims contact without doubt."""
    return len(patch.points) and patch.doubt.touch_probability >= 0.9 and not patch.doubt.reasons


COARSE = (60, 36)


def coarse(scene="cup", **options):
    return SimulatorSource(scene, cells=COARSE, variant=Variant(**options), cameras="tactile")


@pytest.fixture(scope="module")
def at_rest():
    """The pipeline of a coarse membrane that was measured and captured untouched."""
    with coarse(press="none") as source:
        return ContactPipeline(measured_rig(PRESSURE, source), source.rig, untouched_frame(source))


@pytest.mark.parametrize(("across_px", "off_px", "agrees"), [(0, 0, True), (20, 0, True), (80, 20, False)])
def test_the_force_does_not_need_what_a_hole_hides_but_the_pressure_does(pressed, across_px, off_px, agrees):
    rig, preset, frame, untouched = pressed
    v, u = (int(each.mean()) for each in np.nonzero(frame.truth.contact))
    depth = frame.tactile_depth.copy()
    cv2.circle(depth, (u + off_px, v), across_px // 2, 0, cv2.FILLED)
    patch = ContactPipeline(preset.with_value("pressure.gauge_pa", frame.truth.inflation_pa), rig, untouched).process(
        replace(frame, tactile_depth=depth)
    )
    assert np.linalg.norm(np.subtract(patch.force_n, frame.truth.force_n)) < 0.15 * np.linalg.norm(frame.truth.force_n)
    assert patch.pressure.agrees == agrees == ("force and pressure disagree" not in patch.doubt.reasons)


def test_a_gentle_touch_below_the_noise_of_a_narrow_window_is_found(at_rest):
    with coarse("octopus", press="low") as source:
        frames = [source.read(number) for number in range(4)]
    away_px = cv2.distanceTransform((~frames[0].truth.contact).view(np.uint8), cv2.DIST_L2, 5)
    for frame in frames:
        patch = at_rest.process(frame)
        assert len(patch.points)
        assert np.median(away_px[patch.mask]) < 20
    assert at_rest.process(frames[0]).doubt.touch_probability > 0.5, "the doubt counts that window, too"


@pytest.mark.parametrize(("sensor", "seed", "most"), [("l515-d405", 0, 2), ("l515-d405", 1, 2), ("heavy", 1, 0)])
def test_what_hovers_is_not_claimed_and_noise_in_a_narrow_window_is_no_contact(sensor, seed, most):
    def noisy(**options):
        return SimulatorSource("cup", seed, sensor=sensor, cells=COARSE, variant=Variant(**options), cameras="tactile")

    with noisy(press="none") as source:
        at_rest = ContactPipeline(measured_rig(PRESSURE, source), source.rig, untouched_frame(source))
    with noisy(gap_mm=2.0) as source:
        found = [at_rest.process(source.read(number)) for number in range(10)]
    assert not any(claimed(patch) for patch in found)
    assert sum(len(patch.points) > 0 for patch in found) <= most


@pytest.mark.parametrize("offset_m", [(0.170, 0.0), (0.0, 0.105), (0.0, 0.150)])
@pytest.mark.parametrize("press", ["low", "medium"])
def test_a_hand_on_the_rim_is_claimed_where_it_touches_or_doubted(at_rest, monkeypatch, offset_m, press):
    monkeypatch.setitem(OBJECTS, "hand", replace(OBJECTS["hand"], offset_m=offset_m))
    with coarse("hand", press=press) as source:
        frames = [source.read(number) for number in range(3)]
    for frame in frames:
        patch = at_rest.process(frame)
        if claimed(patch):
            near = cv2.dilate(frame.truth.contact.view(np.uint8), np.ones((21, 21), np.uint8)) > 0
            assert near[patch.mask].mean() > 0.8


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_a_bubble_that_was_inflated_more_or_less_since_is_no_contact(share):
    """A smaller or larger pressure changes the curvature of the whole bubble, and lifts or sinks it."""
    rig = Rig.of_one_camera(simulator_rig().tactile)
    rest, now = bubble(rig, 0.2), bubble(rig, 0.2 / share, 0.3 + 0.05 * (share - 1))
    patch = ContactPipeline(PRESSURE, rig, rest).process(now)
    assert patch.pressure.curvature_growth == pytest.approx(share, rel=0.02)
    assert not claimed(patch)
    assert not len(patch.points)


@pytest.mark.parametrize(("radius_m", "counts", "said"), [(0.15, 10, False), (0.25, 0, True)])
def test_more_noise_than_measured_is_no_contact_and_less_inflation_is_doubted(radius_m, counts, said):
    rig = Rig.of_one_camera(simulator_rig().tactile)
    rest, now = bubble(rig, 0.15, rim=True), bubble(rig, radius_m, rim=True)
    known = rig_noise(correlated_m=1e-4, distance_m=np.median(rest.tactile_depth) * 1e-4).model_dump()
    noise = cv2.GaussianBlur(np.random.default_rng(0).normal(size=now.tactile_depth.shape), (0, 0), 5.0)
    noisy = np.rint(now.tactile_depth + counts * noise / noise.std()).astype(np.uint16)
    patch = ContactPipeline(PRESSURE.with_value("noise", known), rig, rest).process(replace(now, tactile_depth=noisy))
    assert patch.doubt.touch_probability < 0.9
    assert ("inflation changed" in patch.doubt.reasons) is said


@pytest.mark.parametrize("shape", ["flat", "dented"])
def test_a_deflated_membrane_is_doubted_and_no_contact(shape):
    rig = Rig.of_one_camera(simulator_rig().tactile)
    rest = bubble(rig, 0.2)
    depth = np.full_like(rest.tactile_depth, 3000) if shape == "flat" else 6000 - rest.tactile_depth
    now = SensorFrame.of_shots(rig, 0, None, Shot(depth, None, 0.0))
    patch = ContactPipeline(PRESSURE, rig, rest).process(now)
    assert not len(patch.points)
    assert "membrane deflated" in patch.doubt.reasons
    assert json.dumps(patch.pressure.record(), allow_nan=False)


def test_a_press_at_the_rim_is_doubted(pressed):
    """A hand on the rim: only the part of a press that lies beside missing depth is seen."""
    rig, preset, frame, untouched = pressed
    columns = np.flatnonzero(frame.truth.contact.any(axis=0))
    edge = int(columns.mean())
    cut, rest = frame.tactile_depth.copy(), untouched.tactile_depth.copy()
    cut[:, edge:] = rest[:, edge:] = 0
    beside, free = (SensorFrame.of_shots(rig, 0, None, Shot(depth, None, 0.0)) for depth in (cut, rest))
    patch = ContactPipeline(preset, rig, free).process(beside)
    assert not claimed(patch)
    assert not len(patch.points) or "at the rim" in patch.doubt.reasons


@pytest.mark.parametrize(("side_px", "found"), [(400, "flat"), (7, "too little tactile depth")])
def test_an_untouched_membrane_that_is_flat_or_smaller_than_a_cell_is_refused(side_px, found):
    lens = simulator_rig().tactile.intrinsics.model_copy(update={"width": side_px, "height": side_px})
    rig = Rig.of_one_camera(simulator_rig().tactile.model_copy(update={"intrinsics": lens}))
    noise = cv2.GaussianBlur(np.random.default_rng(0).normal(size=lens.shape), (0, 0), 10.0)  # of 1 mm
    flat = SensorFrame.of_shots(rig, 0, None, Shot(np.rint(3000 + 350 * noise).astype(np.uint16), None, 0.0))
    with pytest.raises(RigMismatchError, match=found):
        ContactPipeline(PRESSURE, rig, flat).process(flat)


@pytest.mark.parametrize("kind", ["folder", "recording"])
def test_a_recording_of_one_camera_gives_the_same_patch(pressed, tmp_path, kind):
    rig, preset, frame, untouched = pressed
    with open_source("sim:cup?press=medium&cameras=tactile") as source:
        write = export_folder if kind == "folder" else export_mcap
        path = tmp_path / ("take" if kind == "folder" else "take.mcap")
        write(source, path, 2)
    with open_source(str(path)) as stored:
        assert stored.rig == rig and not stored.rig.has_proximity and stored.health().ok
        read = stored.next_frame()
    assert "proximity" not in {image.stem.partition("_")[0] for image in tmp_path.rglob("*.png")}
    ours, theirs = (ContactPipeline(preset, rig, untouched).process(each).points for each in (frame, read))
    assert np.array_equal(ours, theirs)
