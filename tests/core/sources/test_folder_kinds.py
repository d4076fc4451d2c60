"""Folders of images that other people have: layouts, kinds of depth and colour, lens files, and units."""

import json
import re
from itertools import pairwise

import cv2
import numpy as np
import pytest

from tactune.core.calibration.rig_from_folder import rig_from_folder
from tactune.core.errors import TactuneError
from tactune.core.model.intrinsics import Distortion
from tactune.core.sources.folder import FolderSource, write_rig

SHAPE = 24, 32
LENS = "30,30,15.5,11.5"
DEPTH = np.full(SHAPE, 400, np.uint16)
DEPTH[:, 29:] = 500
DEPTH[0, 0] = 0
COLOR = np.zeros((*SHAPE, 3), np.uint8)
COLOR[:, :16] = 10, 120, 250  # BGR


def save(path, image):
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".npy":
        np.save(path, image)
    else:
        assert cv2.imwrite(str(path), image)


def make_rig(folder, unit="mm", **options):
    given = dict.fromkeys(("proximity", "tactile", "color")) | options
    found = rig_from_folder(folder, given, unit)
    write_rig(folder, found.rig, found.forms)
    return found


METRES = np.where(DEPTH > 0, DEPTH / 1000, np.nan)
DEPTHS = {
    "png": (DEPTH, "mm"),
    "PNG": (DEPTH, "0.001"),
    "tif": (DEPTH, "proximity=1/1000,tactile=mm"),
    "tiff": (METRES.astype(np.float32), "m"),
    "npy": (DEPTH, "mm"),
    "pgm": (DEPTH, "mm"),
}
ARRAYS = {
    "float32 metres": (METRES.astype(np.float32), None),
    "float64 metres": (METRES, None),
    "float32 millimetres": (np.where(DEPTH > 0, DEPTH, np.inf).astype(np.float32), "mm"),
    "int64": (DEPTH.astype(np.int64), "mm"),
    "one channel": (DEPTH[..., None], "mm"),
}


@pytest.mark.parametrize(
    ("suffix", "image", "unit"),
    [(suffix, *values) for suffix, values in DEPTHS.items()] + [("npy", *values) for values in ARRAYS.values()],
    ids=[*DEPTHS, *ARRAYS],
)
def test_depth_of_any_form_has_the_same_metres(tmp_path, suffix, image, unit):
    for role in ("proximity", "tactile"):
        save(tmp_path / f"{role}_depth.{suffix}", image)
    save(tmp_path / "proximity_color.png", COLOR)
    found = make_rig(tmp_path, unit, proximity=LENS, tactile=LENS)
    frame = FolderSource(tmp_path).read(0)
    for role in ("proximity", "tactile"):
        metres = getattr(frame, f"{role}_depth") * getattr(found.rig, role).depth_unit_m
        np.testing.assert_allclose(metres, DEPTH / 1000, atol=1e-6)
    assert not [warning for warning in found.warnings if "unit" in warning]


GRAY = np.zeros(SHAPE, np.uint8)
GRAY[:, :16] = 90
COLORS = {
    "jpg": (".jpg", COLOR, (250, 120, 10)),
    "png with alpha": (".png", np.dstack([COLOR, np.full(SHAPE, 7, np.uint8)]), (250, 120, 10)),
    "grey": (".png", GRAY, (90, 90, 90)),
    "grey JPEG": (".jpeg", GRAY, (90, 90, 90)),
    "16 bits": (".png", COLOR.astype(np.uint16) * 256 + 3, (250, 120, 10)),
}


@pytest.mark.parametrize("kind", COLORS)
def test_colour_of_any_form_is_rgb(tmp_path, kind):
    suffix, image, rgb = COLORS[kind]
    save(tmp_path / f"proximity_color{suffix}", image)
    for role in ("proximity", "tactile"):
        save(tmp_path / f"{role}_depth.png", DEPTH)
    make_rig(tmp_path, proximity=LENS, tactile=LENS)
    color = FolderSource(tmp_path).read(0).proximity_color.astype(int)
    assert np.abs(color[:, 2:12] - rgb).max() <= 4  # JPEG


# --- layouts -------------------------------------------------------------------------------------------


def tum(folder):
    """Depth at 10 Hz, colour 20 ms later, one colour image missing, names that are no times."""
    lists = {"depth": ["# depth maps", "# timestamp filename"], "rgb": ["# color images"]}
    for index in range(4):
        for kind, late_s in (("depth", 0.0), ("rgb", 0.02)):
            name = f"{kind}/{'ab' if kind == 'rgb' else 'd'}{index}.png"
            if (kind, index) != ("rgb", 2):
                save(folder / name, DEPTH * 5 if kind == "depth" else COLOR + index)
                lists[kind].append(f"{1305031102 + index / 10 + late_s:.6f} {name}")
    for kind, lines in lists.items():
        (folder / f"{kind}.txt").write_text("\n".join(lines))
    (folder / "groundtruth.txt").write_text("# tx ty tz\n1305031102.1 1 2 3 0 0 0 1\n")


def tum_associations(folder):
    for index in range(4):
        save(folder / f"depth/{index}.png", DEPTH * 5)
        save(folder / f"rgb/{index + 7}.jpg", COLOR)
    lines = [f"{i}.5 depth/{i}.png {i}.51 rgb/{i + 7}.jpg" for i in range(4) if i != 2]
    (folder / "associations.txt").write_text("\n".join(lines))


def bop(folder):
    for index in range(3):
        save(folder / f"rgb/{index:06d}.jpg", COLOR)
        save(folder / f"depth/{index:06d}.png", DEPTH * 10)
        save(folder / f"mask/{index:06d}_000000.png", GRAY)
    camera = {"cam_K": [30.0, 0, 15.5, 0, 31.0, 11.5, 0, 0, 1], "depth_scale": 0.1}
    (folder / "scene_camera.json").write_text(json.dumps({str(index): camera for index in range(3)}))


def roles(folder):
    for index in (3, 20, 100):
        save(folder / f"proximity/depth_{index}.npy", DEPTH)
        save(folder / f"proximity/color_{index}.jpg", COLOR)
        save(folder / f"tactile/depth/{index:05d}.tiff", DEPTH)
    save(folder / "tactile/depth/00021.tiff", DEPTH)


def flat(folder):
    for index in range(2):
        for name in ("proximity_depth", "tactile_depth", "proximity_rgb"):
            save(folder / f"frame{index:04d}_{name}.png", COLOR if "rgb" in name else DEPTH)


def models(folder):
    for index in range(2):
        for name in ("depth_l515", "depth_d405", "rgb_l515"):
            save(folder / f"{index}_{name}.png", COLOR if "rgb" in name else DEPTH)


def subfolders(folder):
    for index in range(2):
        save(folder / f"{index}/depth.png", DEPTH)
        save(folder / f"{index}/ir.png", GRAY)
        save(folder / f"{index}/rgb.png", COLOR)


#: Writer, options, frames, images without a partner, frames without colour, warning-free unit in metres.
LAYOUTS = {
    "TUM": (tum, {"proximity": LENS}, 4, 0, 1),
    "TUM associations": (tum_associations, {"proximity": LENS}, 3, 0, 0),
    "BOP": (bop, {}, 3, 0, 0),
    "roles": (roles, {"proximity": LENS, "tactile": LENS, "unit": "mm"}, 3, 1, 0),
    "flat": (flat, {"proximity": LENS, "tactile": LENS, "unit": "mm"}, 2, 0, 0),
    "models": (models, {"proximity": LENS, "tactile": LENS, "unit": "mm"}, 2, 0, 0),
    "subfolders": (subfolders, {"proximity": LENS, "unit": "mm"}, 2, 0, 0),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_layout_is_found_with_its_unit_and_its_gaps(tmp_path, layout):
    write, options, frames, unmatched, colorless = LAYOUTS[layout]
    write(tmp_path)
    found = make_rig(tmp_path, options.pop("unit", None) if "unit" in options else None, **options)
    with FolderSource(tmp_path) as source:
        read = list(source)
        assert (len(read), source.health().unmatched) == (frames, unmatched)
        one_camera = not any("proximity: " in note for note in found.notes)
        assert source.rig.has_proximity != one_camera
    for frame in read:
        metres = frame.proximity_depth * found.rig.proximity.depth_unit_m
        np.testing.assert_allclose(metres, DEPTH / 1000, atol=1e-6)
    assert sum(not frame.proximity_color.any() for frame in read) == colorless


def test_a_lens_beside_the_images_is_found_and_one_of_both_cameras_tells_no_pose(tmp_path):
    flat(tmp_path)
    (tmp_path / "K.txt").write_text("30 0 15.5 0 31 11.5 0 0 1")
    found = make_rig(tmp_path, "mm")
    assert found.rig.T_proximity_tactile is None
    assert "both cameras have the lens" in " ".join(found.warnings)
    (tmp_path / "K.txt").rename(tmp_path / "ost.yaml")
    (tmp_path / "left_intrinsics.txt").write_text("1 0 0")
    (tmp_path / "right_intrinsics.txt").write_text("1 0 0")
    with pytest.raises(TactuneError, match=r"left_intrinsics\.txt and right_intrinsics\.txt may state it"):
        make_rig(tmp_path, "mm")


def test_colour_of_another_size_of_the_only_camera_is_left_out(tmp_path):
    save(tmp_path / "depth/1.png", DEPTH)
    save(tmp_path / "rgb/1.png", cv2.resize(COLOR, (64, 48)))
    found = make_rig(tmp_path, "tactile=mm", tactile=LENS)
    assert "left out" in " ".join(found.warnings)
    with FolderSource(tmp_path) as source:
        assert not source.read(0).proximity_color.any() and "no colour" in source.health().message


def test_images_of_two_cameras_are_paired_by_time_at_most_half_a_period_apart(tmp_path):
    for index in range(5):
        save(tmp_path / f"proximity_depth/{17000 + index / 10:.6f}.png", DEPTH)
        late_s = 0.06 if index == 2 else 0.04
        save(tmp_path / f"tactile_depth/{17000 + index / 10 + late_s:.6f}.png", DEPTH)
    make_rig(tmp_path, proximity=LENS, tactile=LENS)
    with FolderSource(tmp_path) as source:
        skews = [frame.skew_s for frame in source]
        assert len(skews) in (4, 5)
        assert max(np.abs(skews)) <= 0.05 + 1e-6
        assert source.health().unmatched > 0


REFUSED = {
    "depth as a picture": ({"proximity_depth.png": COLOR}, r"proximity_depth\.png has uint8.*, 3\).*save depth itself"),
    "8 bits": ({"tactile_depth.jpg": GRAY}, r"\.jpg has uint8, .*; save depth itself: one channel of 16 bits"),
    "npy stack": ({"proximity_depth.npy": np.zeros((2, 3, 4, 5), np.uint16)}, r"proximity_depth\.npy"),
    "two of one name": ({"proximity_depth.npy": DEPTH, "proximity_depth.png": DEPTH}, "remove one"),
    "counts beyond 16 bits": ({"proximity_depth.npy": DEPTH.astype(np.int64) * 1000}, "0 to 500000"),
    "nothing": ({"mask.png": GRAY}, "has no frames"),
    "half": ({"proximity/depth/1.png": DEPTH}, "has depth of the proximity camera only"),
    "two depths of a frame": ({"depth/1.png": DEPTH, "depth_raw/1.png": DEPTH}, "keep one"),
    "strangers": ({"proximity_depth/1.png": DEPTH, "tactile_depth/2.png": DEPTH}, "partner"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_is_refused_with_the_name_of_the_file(tmp_path, case):
    images, sentence = REFUSED[case]
    for name, image in images.items():
        save(tmp_path / name, image)
    with pytest.raises(TactuneError, match=sentence) as caught:
        make_rig(tmp_path, proximity=LENS, tactile=LENS)
    assert "\n" not in str(caught.value)


# --- units -----------------------------------------------------------------------------------------------


@pytest.fixture
def plain(tmp_path):
    for role in ("proximity", "tactile"):
        save(tmp_path / f"{role}_depth.png", DEPTH)
    save(tmp_path / "proximity_color.png", COLOR)
    return tmp_path


UNITS = {  # unit, proximity, tactile: unit of both in metres or what refuses it, and a warning
    "given": ("mm", LENS, LENS, (0.001, 0.001), None),
    "each": ("proximity=0.0005,tactile=1/1000", LENS, LENS, (0.0005, 0.001), None),
    "given against the model": ("mm", f"L515={LENS}", f"D405={LENS}", (0.001, 0.001), None),
    "assumed": (None, f"D435={LENS}", f"D435={LENS}", (0.001, 0.001), "assumed.*--unit"),
    "given and implausible": ("0.0001", LENS, LENS, (0.0001, 0.0001), "implausible"),
    "implausible": (None, f"L515={LENS}", f"D405={LENS}", r"below 0\.1 m.*--unit", None),
    "no model": (None, LENS, LENS, "unit of the proximity depth is unknown.*--unit", None),
    "one of two": ("tactile=mm", LENS, LENS, "unit of the proximity depth is unknown", None),
    "nonsense": ("inch", LENS, LENS, "is 'inch'", None),
    "metres for counts": ("m", LENS, LENS, "a count is at most", None),
    "a model with nothing behind it": ("mm", "L515=", LENS, (0.001, 0.001), None),
    "no such lens": ("mm", "none.yaml", LENS, "none.yaml: No such file.*check the path", None),
    "a lens of nothing": ("mm", "D405=0,30,15,11", LENS, r"'D405=0,30,15,11': its lens .*fx is 0\.0", None),
    "no lens": ("mm", None, LENS, "lens of the proximity camera is unknown", None),
}


@pytest.mark.parametrize("case", UNITS)
def test_a_unit_is_given_or_refused_or_told(plain, case):
    unit, proximity, tactile, expected, warning = UNITS[case]
    options = {"proximity": proximity, "tactile": tactile, "color": None}
    if isinstance(expected, str):
        with pytest.raises(TactuneError, match=expected):
            rig_from_folder(plain, options, unit)
        return
    found = rig_from_folder(plain, options, unit)
    assert (found.rig.proximity.depth_unit_m, found.rig.tactile.depth_unit_m) == pytest.approx(expected)
    told = " ".join(each for each in found.warnings if "unit" in each)
    if warning is None:
        assert not told
    else:
        assert re.search(warning, told)


# --- lens files --------------------------------------------------------------------------------------------

K = "30, 0, 15.5, 0, 31, 11.5, 0, 0, 1"
ROS = """\
image_width: 32
image_height: 24
camera_name: narrow
camera_matrix: {{rows: 3, cols: 3, data: [{k}]}}
distortion_model: {model}
distortion_coefficients: {{rows: 1, cols: {n}, data: [{d}]}}
"""


def ros(model, *d):
    return ROS.format(k=K, model=model, n=len(d), d=", ".join(map(str, d)))


KALIBR = """\
cam0:
  camera_model: pinhole
  intrinsics: [30, 31, 15.5, 11.5]
  distortion_model: {0}
  distortion_coeffs: [0.1, -0.05, 0.001, 0.002]
  resolution: [32, 24]
  rostopic: /near/image
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.05]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.02]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  intrinsics: [40, 41, 15.5, 11.5]
  distortion_model: none
  distortion_coeffs: []
  resolution: [32, 24]
  rostopic: /far/image
"""
BROWN = (0.1, -0.05, 0.001, 0.002, 0.0)
FILES = {  # text, Brown-Conrady's coefficients, whether rectified
    "ros.yaml": (ros("plumb_bob", *BROWN), BROWN, False),
    "rational.yaml": (ros("rational_polynomial", *BROWN, 0.8, 0.4, 0.2), (), True),
    "rational_plain.yaml": (ros("rational_polynomial", *BROWN, 0, 0, 0), BROWN, False),
    "equidistant.yml": (ros("equidistant", 0.1, 0.02, 0, 0), (), True),
    "echo.yaml": (
        "height: 48\nwidth: 64\ndistortion_model: plumb_bob\nd: [0.1, -0.05, 0.001, 0.002, 0]\n"
        "k: [60, 0, 31, 0, 62, 23, 0, 0, 1]\nbinning_x: 2\nbinning_y: 2\nroi: {x_offset: 0, y_offset: 0}\n---\n",
        BROWN,
        False,
    ),
    "K.txt": ("30 0 15.5\n0 31 11.5\n0 0 1\n", (), False),
    "four.txt": ("# fx fy cx cy\n30, 31, 15.5, 11.5\n", (), False),
    "numpy.txt": ("[[3.0e+01 0.0e+00 1.55e+01]\n [0. 31. 11.5]\n [0. 0. 1.]]", (), False),
    "open3d.json": (
        '{"width": 32, "height": 24, "intrinsic_matrix": [30, 0, 0, 0, 31, 0, 15.5, 11.5, 1]}',
        (),
        False,
    ),
    "names.json": ('{"fx": 30, "fy": 31, "cx": 15.5, "cy": 11.5, "width": 32, "height": 24}', (), False),
    "kalibr.yaml:cam0": (KALIBR.format("radtan"), BROWN, False),
    "kalibr_fisheye.yaml:cam0": (KALIBR.format("equidistant"), (), True),
}


def opencv_file(path, *, coefficients):
    """OpenCV's own writer."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    file.write("image_width", 32)
    file.write("image_height", 24)
    file.write("camera_matrix", np.array([[30, 0, 15.5], [0, 31, 11.5], [0, 0, 1.0]]))
    file.write("distortion_coefficients", np.array([*BROWN, 0.8, 0.4, 0.2])[:coefficients])
    file.release()


OPENCV = {f"opencv{n}{suffix}": n for n in (5, 8) for suffix in (".yaml", ".xml", ".json")}


@pytest.mark.parametrize("name", [*FILES, *OPENCV])
def test_a_lens_file_of_another_program_is_read_and_the_folder_plays(plain, name):
    path = plain.parent / "lenses" / name.partition(":")[0]
    path.parent.mkdir(exist_ok=True)
    if name in OPENCV:
        opencv_file(path, coefficients=OPENCV[name])
        coefficients, is_rectified = (BROWN, False) if OPENCV[name] == 5 else ((), True)
    else:
        text, coefficients, is_rectified = FILES[name]
        path.write_text(text)
    found = make_rig(plain, proximity=f"D435={path.parent / name}", tactile=LENS)
    lens = found.rig.proximity.intrinsics
    assert (lens.fx, lens.fy) == (30, 31)
    assert lens.distortion is (Distortion.BROWN_CONRADY if coefficients else Distortion.NONE)
    assert lens.coefficients == pytest.approx(coefficients or (0,) * 5)
    assert ("rectify" in found.forms["proximity"]) == is_rectified
    frame = FolderSource(plain).read(0)
    assert np.array_equal(frame.proximity_depth, DEPTH) != is_rectified
    assert {0, 400, 500} >= set(np.unique(frame.proximity_depth).tolist())


def test_a_camchain_of_both_cameras_gives_their_pose(plain):
    path = plain.parent / "camchain.yaml"
    path.write_text(KALIBR.format("radtan"))
    found = rig_from_folder(plain, {"proximity": f"{path}:cam0", "tactile": f"{path}:cam1", "color": None}, "mm")
    pose = np.array(found.rig.T_proximity_tactile)
    np.testing.assert_allclose(pose[:3, 3], [0.05, 0, -0.02])  # cam0's frame, of a point at cam1's origin
    swapped = rig_from_folder(plain, {"proximity": f"{path}:cam1", "tactile": f"{path}:cam0", "color": None}, "mm")
    np.testing.assert_allclose(np.array(swapped.rig.T_proximity_tactile)[:3, 3], [-0.05, 0, 0.02])
    for option in (str(path), f"{path}:cam7"):
        with pytest.raises(TactuneError, match="cam0, cam1"):
            rig_from_folder(plain, {"proximity": option, "tactile": LENS, "color": None}, "mm")


BOMB = "a: &a [1]\n" + "".join(f"{n}: &{n} [*{m}, *{m}]\n" for m, n in pairwise("abcdefghijklm")) + "K: *m\n"
BAD_LENSES = {
    "omni.yaml": (KALIBR.replace("camera_model: pinhole", "camera_model: omni", 1).format("radtan"), "'omni'"),
    "fov.yaml": (KALIBR.format("fov"), "'fov' with 4 coefficients"),
    "size.yaml": (ros("plumb_bob", *BROWN).replace("32", "64"), "64 x 24 pixels, but these have 32 x 24"),
    "skew.txt": ("30 1 15.5 0 31 11.5 0 0 1", "skew"),
    "numbers.txt": ("1 2 3", "3 numbers"),
    "words.txt": ("hello you", "words"),
    "empty.yaml": ("", "NoneType"),
    "other.yaml": ("a: 1\nb: {c: 2}\n", "states no lens"),
    "half.yaml": ("fx: 30\n", "'fy' is missing"),
    "broken.yaml": ("a: [1, 2\nb: }", "is no file of a lens"),
    "broken.xml": ("<opencv_storage><camera", "is no file of a lens"),
    "deep.yaml": ("[" * 5000, "is no file of a lens"),
    "bomb.yaml": (BOMB, "aliases stand for"),
    "wide.yaml": (ros("plumb_bob", *BROWN).replace("30, 0", "3000, 0"), "fx is 3000 px"),
    "nan.yaml": (ros("plumb_bob", float("nan"), 0, 0, 0, 0), "not finite|no file"),
}


@pytest.mark.parametrize("name", BAD_LENSES)
def test_a_lens_that_cannot_be_used_is_refused_by_name(plain, name):
    text, sentence = BAD_LENSES[name]
    path = plain.parent / name
    path.write_text(text)
    choice = ":cam0" if "cam0" in text else ""
    with pytest.raises(TactuneError, match=sentence) as caught:
        rig_from_folder(plain, {"proximity": f"D435={path}{choice}", "tactile": LENS, "color": None}, "mm")
    assert "\n" not in str(caught.value)
