"""Roll, pitch and long axis of a patch: exact planes, what is not determined, sigmas; a tray levelled by them."""

import math
import runpy
from pathlib import Path

import cv2
import numpy as np
import pytest

from tactune.core import load_preset
from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.estimation.tilt import TiltEstimator
from tactune.core.preset import CameraNoise, RigNoise, now
from tactune.core.sources.simulator.scenes import Variant
from tactune.core.sources.simulator.simulator_source import SimulatorSource

PRESET = load_preset("simulator")
CENTRE = 325.0, 238.0


@pytest.fixture(scope="module")
def cup():
    source = SimulatorSource("cup", variant=Variant(press="medium"))
    return source, ContactPipeline(PRESET, source.rig).process(source.read(0))


@pytest.fixture(scope="module")
def rig(cup):
    return cup[0].rig


def pixels(half_u, half_v, turn=0.0):
    """Return u, v of the pixels in an ellipse, its long side turned from right towards down."""
    v, u = np.mgrid[:480, :640]
    du, dv = u - CENTRE[0], v - CENTRE[1]
    along, across = du * np.cos(turn) + dv * np.sin(turn), dv * np.cos(turn) - du * np.sin(turn)
    inside = (along / half_u) ** 2 + (across / half_v) ** 2 < 1
    return u[inside], v[inside]


def plane_points(rig, u, v, roll, pitch, distance=0.26):
    lens = rig.proximity.intrinsics
    rays = np.stack([(u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy, np.ones(len(u))], axis=1)
    about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    normal = about_y @ about_x @ [0.0, 0.0, 1.0]
    return rays * (normal[2] * distance / (rays @ normal))[:, None]


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.2, 0.0), (0.0, 0.2), (-0.3, 0.25)])
def test_exact_planes(rig, roll, pitch):
    points = plane_points(rig, *pixels(90, 50), roll, pitch)
    tilt = TiltEstimator(PRESET, rig).of_points(points)
    assert (tilt.roll_rad, tilt.pitch_rad) == pytest.approx((roll, pitch), abs=2e-6)
    assert tilt.centroid_m == pytest.approx(points.mean(axis=0))


def test_a_line_determines_one_angle_and_a_dot_none(rig):
    estimator = TiltEstimator(PRESET, rig)
    u, v = pixels(90, 1.2)
    line = estimator.of_points(plane_points(rig, u, v, 0.1, 0.05))
    assert (line.roll_rad, line.roll_sigma_rad) == (None, None)
    assert line.pitch_rad == pytest.approx(0.05, abs=1e-3)
    slanted = estimator.of_points(plane_points(rig, *pixels(90, 1.2, 0.7), 0.1, 0.05))
    assert (slanted.roll_rad, slanted.pitch_rad) == (None, None)
    dot = estimator.of_points(plane_points(rig, *pixels(3, 3), 0.1, 0.05))
    assert set(dot.record().values()) == {None}
    assert set(estimator.of_points(np.empty((0, 3), np.float32)).record().values()) == {None}


@pytest.mark.parametrize("turn", [-1.2, -0.4, 0.0, 0.9])
def test_long_axis(rig, turn):
    estimator = TiltEstimator(PRESET, rig)
    tilt = estimator.of_points(plane_points(rig, *pixels(90, 45, turn), 0.0, 0.0))
    assert tilt.axis_rad == pytest.approx(turn, abs=0.01)
    assert 0 < tilt.axis_sigma_rad < 0.1
    round_ = estimator.of_points(plane_points(rig, *pixels(60, 59, turn), 0.0, 0.0))
    assert (round_.axis_rad, round_.axis_sigma_rad) == (None, None)


def noise_of(proximity, tactile):
    make = (
        CameraNoise(white_m=w, correlated_m=c, length_px=px, changing_share=0.5, distance_m=0.26)
        for w, c, px in (proximity, tactile)
    )
    return RigNoise(proximity=next(make), tactile=next(make), measured=now(), frames=30)


def smooth_noise(rng, length_px):
    """Noise that neighbours share, made small and enlarged."""
    by = max(int(length_px / 6), 1)
    field = cv2.GaussianBlur(rng.standard_normal((960 // by, 1280 // by), dtype=np.float32), (0, 0), length_px / by)
    small = field[: 480 // by + 1, : 640 // by + 1] / field.std()
    return cv2.resize(small, None, fx=by, fy=by, interpolation=cv2.INTER_CUBIC)


def test_standard_deviation_of_correlated_noise(rig):
    """Noise of both cameras made here, with the slow error of 0.4 mm that is assumed."""
    length_px, rng, (u, v) = 18.0, np.random.default_rng(5), pixels(70, 45)
    noise = noise_of((0.0006, 0.0009, length_px), (0.0002, 0.0008, 5.0))
    estimator = TiltEstimator(PRESET.model_copy(update={"noise": noise}), rig)
    flat = plane_points(rig, u, v, 0.1, -0.1)
    tactile_px = 5.0 * rig.proximity.intrinsics.fx / rig.tactile.intrinsics.fx
    errors, sigmas = [], []
    for _ in range(60):
        seen = 0.0006 * rng.standard_normal(len(u)) + 0.0009 * smooth_noise(rng, length_px)[v, u]
        seen += 0.0004 * smooth_noise(rng, 640 / 12)[v, u]
        tactile = 0.0008 * smooth_noise(rng, tactile_px)[v, u]
        tilt = estimator.of_points(flat * (1 + seen / flat[:, 2])[:, None], seen - tactile)
        errors += [tilt.roll_rad - 0.1, tilt.pitch_rad + 0.1]
        sigmas += [tilt.roll_sigma_rad, tilt.pitch_sigma_rad]
    stated, found = (np.sqrt(np.mean(np.square(values))) for values in (sigmas, errors))
    assert 0.8 < stated / found < 1.25
    assert 0.6 < np.mean(np.abs(errors) < sigmas) < 0.82


EXAMPLE = Path(__file__).parents[3] / "examples" / "balance_tray.py"


def test_the_tray_is_level_soon_after_a_book(monkeypatch):
    example = runpy.run_path(str(EXAMPLE))
    monkeypatch.setitem(example["balance"].__globals__, "BOOKS", (example["Book"](0.3, 0.35, 0.040),))
    steps = example["balance"](2.0)
    assert max(abs(math.degrees(step.roll_rad)) for step in steps) > 2.0  # the book does roll the tray
    assert abs(math.degrees(steps[-1].sensor_rad)) > 2.0  # the sensor has turned below it
    (settled,) = example["settle_times"](steps)
    assert settled is not None and 0.0 < settled < 1.5
