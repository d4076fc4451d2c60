from __future__ import annotations

import numpy as np
import pytest

from tactune.core.contact.pipeline import ContactPipeline
from tactune.core.errors import PluginError, RigMismatchError, TactuneError
from tactune.core.methods.registry import make_method, method_names, method_problems, needs_untouched, settings_of
from tactune.core.model import plugins
from tactune.core.preset import Preset
from tactune.core.sources.presets import load_preset

NAMES = (
    "fusion-membrane",
    "fusion-averaged",
    "fusion-rigid",
    "fusion-homography",
    "proximity-only",
    "tactile-only",
    "tactile-threshold",
    "mechanics",
)


def test_names():
    assert method_names() == NAMES
    assert [name for name in NAMES if not needs_untouched(name)] == list(NAMES[:4])


@pytest.mark.parametrize("name", NAMES)
def test_every_method_finds_the_cup(cup_frames, name):
    rig, untouched, pressed = cup_frames
    method = make_method(name, load_preset("simulator"), rig, untouched)
    patch = method.find(pressed)
    assert method.name == name
    assert patch.failure == ""
    assert patch.points.dtype == np.float32
    assert patch.points.shape == (len(patch.points), 3)
    assert len(patch.points) > 2000
    assert patch.mask.dtype == bool
    assert patch.mask.shape == rig.proximity.intrinsics.shape
    assert (patch.mask & pressed.truth.contact).sum() > 0.5 * pressed.truth.contact.sum()
    # points lie where the mask says
    pixels = np.rint(rig.proximity.intrinsics.project(patch.points)).astype(int)
    column, row = np.clip(pixels, 0, (639, 479)).T
    assert patch.mask[row, column].mean() > 0.8


@pytest.mark.parametrize("model", ["rigid", "homography"])
def test_fusion_is_the_pipeline_with_that_model(cup_frames, model):
    rig, _, pressed = cup_frames
    preset = load_preset("simulator").with_value("contact_test", "tolerance")
    other = preset.with_values({"alignment.model": "homography" if model == "rigid" else "rigid"})
    found = make_method(f"fusion-{model}", other, rig).find(pressed)
    expected = ContactPipeline(preset.with_values({"alignment.model": model}), rig).process(pressed)
    np.testing.assert_array_equal(found.points, expected.points)
    np.testing.assert_array_equal(found.mask, expected.mask)


@pytest.mark.parametrize("name", [name for name in NAMES if needs_untouched(name)])
def test_a_missing_untouched_frame_is_told(small_rig, name):
    with pytest.raises(TactuneError, match=f"{name} compares with the untouched membrane.*capture one"):
        make_method(name, load_preset("simulator"), small_rig)


def test_an_unknown_method_is_told(small_rig):
    with pytest.raises(TactuneError, match=r"no method 'magic'; known are fusion-membrane, .*, mechanics"):
        make_method("magic", load_preset("simulator"), small_rig)


def test_a_preset_of_another_rig_is_refused(small_rig):
    with pytest.raises(RigMismatchError):
        make_method("fusion-rigid", load_preset("simulator"), small_rig)


CAMERA_NOISE = {"white_m": 0.001, "correlated_m": 0.0, "length_px": 0.0, "changing_share": 1.0, "distance_m": 0.3}
#: Another value for every field of a preset that may decide what is contact.
OTHERS = {
    "alignment.model": "homography",
    "alignment.rigid.T_proximity_tactile": [[1, 0, 0, 0.03], [0, 1, 0, 0.002], [0, 0, 1, 0], [0, 0, 0, 1]],
    "alignment.homography.H_p_t": [[1, 0, 5], [0, 1, 3], [0, 0, 1]],
    "alignment.homography.plane_distance_m": 0.2,
    "alignment.depth_scale": 1.01,
    "alignment.depth_offset_m": 0.002,
    "contact_test": "tolerance",
    "mask.enabled": True,
    "mask.hue": (20, 60),
    "mask.saturation": (10, 40),
    "mask.value": (10, 40),
    "tolerance.t": 0.004,
    "outliers.enabled": False,
    "outliers.k": 5,
    "outliers.ratio": 0.5,
    "outliers.min_cluster_area_mm2": 1000.0,
    "membrane.gap_m": 0.0005,
    "membrane.trust_m": 0.005,
    "membrane.shape_px": 9.0,
    "membrane.bias": False,
    "membrane.min_area_mm2": 5000.0,
    "membrane.frames": 7,
    "noise": {
        "proximity": CAMERA_NOISE,
        "tactile": CAMERA_NOISE,
        "bias_m": 0.003,
        "bias_sigma_m": 0.0003,
        "bias_from": "prints",
        "measured": "2026-01-02T03:04:05Z",
        "frames": 30,
    },
    "range.enabled": True,
    "range.limits_m": (0.1, 0.2),
    "region.enabled": True,
    "region.rectangle": (100, 80, 60, 60),
}
#: Fields that decide nothing, or only what the rig and the untouched frame are, which are given apart.
OTHERWISE = ("name", "notes", "created", "modified", "rig", "cameras", "untouched", "alignment.calibration")


def leaves(data: dict, before: str = "") -> set[str]:
    """Return the dotted paths of all fields that are no sections."""
    paths = set()
    for name, value in data.items():
        path = f"{before}{name}"
        paths |= leaves(value, f"{path}.") if isinstance(value, dict) and path not in OTHERWISE else {path}
    return paths


def test_every_field_of_a_preset_is_looked_at():
    assert leaves(Preset().model_dump()) - set(OTHERWISE) == set(OTHERS)


@pytest.mark.parametrize("name", [*NAMES[:4], "proximity-only", "tactile-threshold"])
def test_where_the_settings_of_a_method_are_equal_so_are_its_patches(bulged, name):
    rig, untouched, pressed = bulged.rig, bulged.frame(0.0), bulged.frame(0.05, 0.0003)
    preset = Preset()
    expected = make_method(name, preset, rig, untouched).find(pressed)
    assert len(expected.points) > 500
    unconcerned = 0
    for path, value in OTHERS.items():
        other = preset.with_value(path, value)
        if settings_of(name, other) == settings_of(name, preset):
            unconcerned += 1
            found = make_method(name, other, rig, untouched).find(pressed)
            np.testing.assert_array_equal(found.points, expected.points, err_msg=path)
    assert unconcerned


@pytest.mark.parametrize(
    ("path", "concerned"),
    [
        ("tolerance.t", {"fusion-rigid", "fusion-homography"}),
        ("membrane.gap_m", {"fusion-membrane", "fusion-averaged"}),
        ("membrane.frames", set()),
        ("noise", {"fusion-membrane", "fusion-averaged"}),
        ("mask.hue", set(NAMES[:4])),
        ("alignment.homography.plane_distance_m", {"fusion-homography"}),
        ("alignment.depth_offset_m", set(NAMES)),
        ("contact_test", set()),
    ],
)
def test_a_field_concerns_only_the_methods_that_use_it(path, concerned):
    preset = Preset()
    other = preset.with_value(path, OTHERS[path])
    assert {name for name in NAMES if settings_of(name, other) != settings_of(name, preset)} == concerned


@pytest.mark.parametrize("name", NAMES[:4])
def test_a_fusion_that_takes_another_preset_is_the_one_made_with_it(bulged, name):
    rig, pressed = bulged.rig, bulged.frame(0.05, 0.0003)
    method = make_method(name, Preset(), rig)
    before = method.find(pressed)
    values = {"alignment.depth_offset_m": 0.0005, "region.enabled": True, "region.rectangle": (100, 80, 60, 60)}
    other = Preset().with_values({**values, "contact_test": "membrane"})
    method.update(other)
    found, expected = method.find(pressed), make_method(name, other, rig).find(pressed)
    np.testing.assert_array_equal(found.points, expected.points)
    assert len(found.points) != len(before.points)


@pytest.fixture
def third_party(tmp_path, monkeypatch):
    """Let this process find a package with a method that needs no untouched frame, and with two broken entries."""
    (tmp_path / "nearest_method.py").write_text(
        "import numpy as np\n"
        "from tactune.core.methods.method import ContactMethod, MethodKind, MethodPatch\n"
        "class Nearest(ContactMethod):\n"
        "    name = 'nearest'\n"
        "    def find(self, frame):\n"
        "        mask = frame.proximity_depth == frame.proximity_depth.min()\n"
        "        return MethodPatch(np.zeros((int(mask.sum()), 3), np.float32), lambda: mask)\n"
        "METHOD = MethodKind('nearest', 'The nearest pixels', (1, 2, 3), lambda preset, rig, untouched: Nearest())\n"
    )
    metadata = tmp_path / "acme_methods-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: acme-methods\nVersion: 1.0\n")
    entries = "nearest = nearest_method:METHOD\ngone = no_such_module:METHOD\nodd = tactune.core.errors:TactuneError\n"
    (metadata / "entry_points.txt").write_text(f"[tactune.methods]\n{entries}")
    monkeypatch.syspath_prepend(str(tmp_path))
    plugins.forget()
    yield
    monkeypatch.undo()
    plugins.forget()


def test_another_packages_method_needs_no_untouched_frame_and_its_broken_ones_are_named(third_party, cup_frames):
    rig, _, pressed = cup_frames
    assert method_names() == (*NAMES, "nearest")
    assert not needs_untouched("nearest")
    patch = make_method("nearest", Preset(), rig).find(pressed)
    assert len(patch.points) == np.count_nonzero(patch.mask) > 0
    assert len(method_problems()) == 2
    for name in ("gone", "odd"):
        with pytest.raises(PluginError, match=rf"entry point '{name}' \(tactune.methods\) of the package acme-methods"):
            make_method(name, Preset(), rig)
