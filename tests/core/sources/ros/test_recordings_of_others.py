"""Recordings of other programs: containers, topics, encodings, lenses, transforms and pairing, each against NumPy."""

import sqlite3
from contextlib import closing
from dataclasses import replace

import cv2
import numpy as np
import pytest

from ros_maker import CHAIN, H, W, color, depth, make_recording
from tactune.core import open_source
from tactune.core.errors import SourceError
from tactune.core.model.intrinsics import Distortion
from tactune.core.sources.ros.topics import stored_path

NEAR, TOUCH = "/l515/depth/image_rect_raw", "/d405/depth/image_rect_raw"
TWO = [depth(NEAR, "a_optical"), depth(TOUCH, "b_optical", 390), color("/l515/color/image_raw", "c_optical")]
RNG = np.random.default_rng(5)


def first_frame(path):
    with open_source(str(path)) as source:
        return source.rig, source.next_frame(), source.health()


def file_in(folder):
    return next(path for path in folder.iterdir() if path.name != "metadata.yaml")


def with_half_metadata(folder):
    """As a recorder that was killed leaves it."""
    text = (folder / "metadata.yaml").read_text()
    return with_names(folder, "", text[: text.index("relative_file_paths")])


def with_names(folder, names, before="rosbag2_bagfile_information:\n  relative_file_paths: "):
    (folder / "metadata.yaml").write_text(before + names)
    return folder


@pytest.mark.parametrize(
    ("kind", "opened"),
    [
        ("mcap", lambda path: path),
        ("mcap", file_in),
        ("mcap", lambda path: path / "metadata.yaml"),
        ("mcap", with_half_metadata),
        ("mcap", lambda path: with_names(path, "[[a], [b]]")),
        ("mcap", lambda path: with_names(path, "[metadata.yaml]")),
        ("sqlite", lambda path: path),
        ("sqlite", file_in),
        ("messages", lambda path: path),
        ("sqlite messages", lambda path: path),
        ("file", lambda path: path),
        ("ros1", lambda path: path),
    ],
)
def test_every_container_plays_the_same(tmp_path, kind, opened):
    path = opened(make_recording(tmp_path / ("take.bag" if kind == "ros1" else "take"), TWO, kind=kind))
    with open_source(str(path)) as source:
        assert source.health().ok, source.health()
        assert source.length == 3 and source.health().ok
        assert np.allclose(np.array(source.rig.T_proximity_tactile)[:3, 3], (0.05, 0.0, 0.0))
        assert np.allclose(np.array(source.rig.proximity_color.T_color_depth)[:3, 3], (0.014, 0.0, 0.0))
        for n, frame in enumerate(source):
            assert (frame.proximity_depth == 400 + n).all()
            assert (frame.tactile_depth == 390 + n).all()
            assert (frame.proximity_color == 90).all()
            assert frame.proximity_time_s == frame.tactile_time_s == pytest.approx(1000 + 0.1 * n)


@pytest.mark.parametrize("kind", ["mcap", "sqlite", "file"])
def test_split_files_open_without_metadata_as_a_folder_or_as_two_paths(tmp_path, kind):
    folder = tmp_path / "split"
    folder.mkdir()
    parts = []
    for number, name in ((0, "drive_0"), (1, "drive_1")):
        file = file_in(make_recording(tmp_path / f"part{number}", TWO, kind=kind, start_s=1000 + number))
        parts.append(file.rename(folder / f"{name}{''.join(file.suffixes)}"))
    names = [str(folder)] + ([f"{parts[1]},{parts[0]}"] if kind != "file" else [])
    for name in names:
        with open_source(name) as source:
            assert [frame.proximity_time_s for frame in source] == pytest.approx(
                [1000, 1000.1, 1000.2, 1001, 1001.1, 1001.2]
            )
    parts[1].rename(folder / f"walk_0{''.join(parts[1].suffixes)}")
    with pytest.raises(SourceError, match=r"files of 2 recordings \(drive, walk\); choose the files of one"):
        open_source(str(folder))


@pytest.mark.parametrize(
    ("near", "touch", "rgb"),
    [
        ("/proximity/depth/image", "/tactile/depth/image", "/proximity/color/image"),
        ("/tof/camera/depth/image_raw", "/camera/camera/depth/image_rect_raw", "/tof/camera/color/image_raw"),
        ("/femto/depth/image_raw", "/d405/camera/depth/image_rect_raw", "/femto/color/image_raw"),
        ("/proximity_oak/stereo/image_raw", "/oak/stereo/image_raw", "/proximity_oak/rgb/image_raw"),
        ("/prox/aligned_depth_to_color/image_raw", "/gel/depth/image_rect_raw", "/prox/color/image_raw"),
    ],
)
def test_names_of_other_drivers_are_guessed(tmp_path, near, touch, rgb):
    infrared = color(f"{touch.rpartition('/depth')[0] or '/oak'}/infra1/image_rect_raw", "b_optical")
    streams = [depth(touch, "b_optical", 390), depth(near, "a_optical"), color(rgb, "c_optical"), infrared]
    _, frame, health = first_frame(make_recording(tmp_path / "take", streams))
    assert (frame.proximity_depth[0, 0], frame.tactile_depth[0, 0]) == (400, 390)
    assert (frame.proximity_color == 90).all(), health


def test_names_that_do_not_tell_are_asked_for_and_the_answer_is_kept(tmp_path):
    path = make_recording(
        tmp_path / "take", [depth("/cam1/depth", "a_optical"), depth("/cam2/depth", "b_optical", 390)]
    )
    with pytest.raises(SourceError, match=r"--topics .* /cam1/depth \(32 x 24, 16UC1, 3 images\); /cam2/depth"):
        first_frame(path)
    named = f"{path}?proximity.depth=/cam2/depth,tactile.depth=/cam1/depth"
    for name in (named, path):
        _, frame, _ = first_frame(name)
        assert (frame.proximity_depth[0, 0], frame.tactile_depth[0, 0]) == (390, 400)
    stored_path(path).write_text("[1]")
    with pytest.raises(SourceError, match="correct or remove it"):
        first_frame(path)


DEPTHS = {
    "16UC1": np.arange(H * W, dtype=np.uint16).reshape(H, W) + 300,
    "mono16": np.arange(H * W, dtype=np.uint16).reshape(H, W) + 300,
    "32FC1": RNG.uniform(0.2, 0.6, (H, W)).astype(np.float32),
}


@pytest.mark.parametrize("big_endian", [False, True])
@pytest.mark.parametrize("encoding", DEPTHS)
def test_depth_encodings(tmp_path, encoding, big_endian):
    image = DEPTHS[encoding].copy()
    if encoding == "32FC1":
        image[0, :3] = np.nan, np.inf, -1
    near = depth(NEAR, "a_optical", images=[image] * 3, encoding=encoding, big_endian=big_endian, padding=8)
    rig, frame, _ = first_frame(make_recording(tmp_path / "take", [near, TWO[1]]))
    metres = frame.proximity_depth * rig.proximity.depth_unit_m
    expected = np.where(np.isfinite(image) & (image > 0), image, 0) * (1.0 if encoding == "32FC1" else 0.001)
    assert np.abs(metres - expected).max() < 1e-4


def packed(image, metres):
    """Compress depth as image_transport does; metres as A / depth + B."""
    scale, offset = 100.0, 1.0
    counts = np.rint(scale / image + offset).astype(np.uint16) if metres else image
    return np.array([0, scale, offset], "<f4").tobytes() + cv2.imencode(".png", counts)[1].tobytes()


@pytest.mark.parametrize("encoding", ["16UC1", "32FC1"])
def test_compressed_depth(tmp_path, encoding):
    data = packed(DEPTHS[encoding], encoding == "32FC1")
    topic = "/l515/depth/image_rect_raw/compressedDepth"
    near = depth(
        topic,
        "a_optical",
        images=[data] * 3,
        encoding=f"{encoding}; compressedDepth png",
        info="/l515/depth/camera_info",
    )
    rig, frame, _ = first_frame(make_recording(tmp_path / "take", [near, TWO[1]]))
    expected = DEPTHS[encoding] * (1.0 if encoding == "32FC1" else 0.001)
    assert np.abs(frame.proximity_depth * rig.proximity.depth_unit_m - expected).max() < 2e-3


RGB = np.kron(RNG.integers(40, 200, (H // 4, W // 4, 3)), np.ones((4, 4, 1))).astype(np.uint8)
GREY = cv2.cvtColor(RGB, cv2.COLOR_RGB2GRAY)


def luma_and_chroma():
    """Y, U and V as video has them: 16 to 235, by ITU-R BT.601."""
    weights = np.array([[65.481, 128.553, 24.966], [-37.797, -74.203, 112.0], [112.0, -93.786, -18.214]])
    return tuple(np.rint(RGB @ weights.T / 255 + (16, 128, 128)).astype(np.uint8).transpose(2, 0, 1))


def yuv(order):
    luma, u, v = luma_and_chroma()
    return np.dstack([luma, np.where(np.arange(W) % 2, v, u)][:: 1 if order == "yuyv" else -1])


def planes(name):
    luma, u, v = luma_and_chroma()
    pair = (v, u) if name == "nv21" else (u, v)
    step = 1 if name == "nv24" else 2
    chroma = np.dstack([each[::step, ::step] for each in pair])
    return np.vstack([luma, chroma.reshape(-1, W)])


def bayer(pattern):
    image = np.empty((H, W), np.uint8)
    for n, letter in enumerate(pattern):
        image[n // 2 :: 2, n % 2 :: 2] = RGB[n // 2 :: 2, n % 2 :: 2, "rgb".index(letter)]
    return image


COLORS = {
    "rgb8": RGB, "bgr8": RGB[..., ::-1], "rgba8": np.dstack([RGB, GREY]), "bgra8": np.dstack([RGB[..., ::-1], GREY]),
    "8UC3": RGB[..., ::-1], "8UC4": np.dstack([RGB[..., ::-1], GREY]),
    "rgb16": RGB.astype(np.uint16) * 256, "bgr16": RGB[..., ::-1].astype(np.uint16) * 256, "mono8": GREY, "8UC1": GREY,
    "mono16": GREY.astype(np.uint16) * 256, "YUYV": yuv("yuyv"), "yuv422_yuy2": yuv("yuyv"), "yuyv": yuv("yuyv"),
    "UYVY": yuv("uyvy"), "uyvy": yuv("uyvy"), "yuv422": yuv("uyvy"), "nv12": planes("nv12"), "nv21": planes("nv21"),
    "nv24": planes("nv24"), "bayer_rggb8": bayer("rggb"), "bayer_bggr8": bayer("bggr"), "bayer_gbrg8": bayer("gbrg"),
    "bayer_grbg8": bayer("grbg"),
}  # fmt: skip


@pytest.mark.parametrize("encoding", COLORS)
def test_color_encodings(tmp_path, encoding):
    image = np.ascontiguousarray(COLORS[encoding])
    seen = color("/l515/color/image_raw", "c_optical", images=[image] * 3, encoding=encoding)
    _, frame, health = first_frame(make_recording(tmp_path / "take", [*TWO[:2], seen]))
    assert health.ok, health
    expected = np.dstack([GREY] * 3) if "mono" in encoding or encoding == "8UC1" else RGB
    inside = np.s_[1::4, 1::4] if "bayer" in encoding else np.s_[:]
    assert np.abs(frame.proximity_color[inside].astype(int) - expected[inside]).max() <= (
        12 if "bayer" in encoding else 4
    )


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_compressed_color(tmp_path, suffix):
    data = cv2.imencode(suffix, RGB[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    seen = color(
        "/l515/color/image_raw/compressed", "c_optical", images=[data] * 3, encoding="rgb8; jpeg compressed bgr8"
    )
    _, frame, _ = first_frame(make_recording(tmp_path / "take", [*TWO[:2], seen]))
    assert np.abs(frame.proximity_color.astype(int) - RGB).mean() < 12


@pytest.mark.parametrize(
    ("model", "d"),
    [
        ("plumb_bob", (0.05, -0.02, 0.001, 0.002, 0.003)),
        ("plumb_bob", (0.05, -0.02, 0.001, 0.002)),
        ("rational_polynomial", (0.05, -0.02, 0.001, 0.002, 0.003, 0.01, 0.02, 0.0)),
        ("rational_polynomial", (0.0,) * 8),
        ("thin_prism", (0.05, -0.02, 0.001, 0.002, 0.003, 0.0, 0.0, 0.0, 0.01, 0.0, 0.02, 0.0)),
        ("equidistant", (0.05, -0.02, 0.001, 0.002)),
        ("equidistant", (0.0,) * 4),
        ("", ()),
        ("none", (0.0,) * 5),
    ],
)
def test_lens_models_see_a_place_where_opencv_does(tmp_path, model, d):
    """A bright spot is deprojected to the ray that OpenCV finds for its pixel."""
    image = np.full((H, W), 400, np.uint16)
    image[6:9, 24:27] = 500
    near = depth(NEAR, "a_optical", images=[image] * 3, model=model, d=d)
    rig, frame, _ = first_frame(make_recording(tmp_path / "take", [near, TWO[1]]))
    k, spot = np.array(near.k).reshape(3, 3), np.array([[[25.0, 7.0]]])
    undistort = cv2.fisheye.undistortPoints if model == "equidistant" else cv2.undistortPoints
    ray = undistort(spot, k, np.array(d)).ravel() if d else (spot.ravel() - k[:2, 2]) / 30
    found = rig.proximity.intrinsics.rays()[frame.proximity_depth == 500].mean(axis=0)
    assert np.abs(found - ray).max() * 30 < 0.6  # pixels
    assert rig.proximity.intrinsics.distortion in (Distortion.NONE, Distortion.BROWN_CONRADY)


def test_rectified_images_have_the_lens_p_and_raw_ones_k_with_its_distortion(tmp_path):
    lens = {"d": (0.2, 0.0, 0.0, 0.0, 0.0), "p": (28.0, 0.0, 15.0, 0.0, 0.0, 29.0, 11.0, 0.0, 0.0, 0.0, 1.0, 0.0)}
    for name, expected in (("image_rect", (28, 29, 15, 11, 0)), ("image_raw", (30, 30, 15.5, 11.5, 0.2))):
        near = depth(f"/l515/depth/{name}", "a_optical", **lens)
        found = first_frame(make_recording(tmp_path / name, [near, TWO[1]]))[0].proximity.intrinsics
        assert (found.fx, found.fy, found.cx, found.cy, found.coefficients[0]) == expected


def test_unknown_lenses_are_named(tmp_path):
    for name, model, d in (("a", "kittens", (0.1,) * 5), ("b", "none", (0.1,) * 5), ("c", "plumb_bob", (np.nan,) * 5)):
        near = depth(NEAR, "a_optical", model=model, d=d)
        with pytest.raises(SourceError, match=rf"{NEAR}: its lens"):
            first_frame(make_recording(tmp_path / name, [near, TWO[1]]))
    near = depth(NEAR, "a_optical", k=(30.0, 0.5, 15.5, 0.0, 30.0, 11.5, 0.0, 0.0, 1.0))
    with pytest.raises(SourceError, match=r"its K has a skew of 0\.5"):
        first_frame(make_recording(tmp_path / "d", [near, TWO[1]]))


def test_binning_region_and_the_first_filled_in_lens(tmp_path):
    near = depth(NEAR, "a_optical", size=(W * 2 + 8, H * 2 + 4), roi=(8, 4, H * 2, W * 2), binning=2, empty_infos=2)
    rig, *_ = first_frame(make_recording(tmp_path / "take", [near, TWO[1]]))
    lens = rig.proximity.intrinsics
    assert (lens.width, lens.height, lens.fx, lens.fy) == (W, H, 15.0, 15.0)
    assert (lens.cx, lens.cy) == ((15.5 - 8) / 2, (11.5 - 4) / 2)
    wrong = depth(NEAR, "a_optical", size=(W * 3, H))
    with pytest.raises(SourceError, match="32 x 24 pixels, its lens 96 x 24"):
        first_frame(make_recording(tmp_path / "wrong", [wrong, TWO[1]]))


@pytest.mark.parametrize("broken", [("rig", "b_link"), ("c_link", "c_optical")])
@pytest.mark.parametrize("turn", [(), (0.0,) * 4, (np.nan,) * 4, (1e-200, 0.0, 0.0, 0.0)])
def test_a_chain_that_is_broken_is_a_gap_not_a_pose(tmp_path, broken, turn):
    """A link is missing, or its quaternion is no rotation."""
    kept = [each for each in CHAIN if turn or each[:2] != broken]
    transforms = tuple((*each[:3], turn) if each[:2] == broken else each for each in kept)
    rig, frame, health = first_frame(make_recording(tmp_path / "take", TWO, transforms))
    assert (rig.T_proximity_tactile is None) == (broken == ("rig", "b_link"))
    assert frame.proximity_color.any() == (broken == ("rig", "b_link"))
    assert not health.ok


@pytest.mark.parametrize("streams", [[], [color("/l515/color/image_raw", "c_optical")]])
def test_without_depth_it_lists_what_there_is(tmp_path, streams):
    with pytest.raises(
        SourceError, match=r"no topic has depth images.*--topics.*(tf_static|color/image_raw)"
    ) as caught:
        first_frame(make_recording(tmp_path / "take", streams))
    assert "record" not in str(caught.value).partition("take")[2]


def test_topics_are_named_in_one_option_or_in_several_and_colour_follows_its_depth(tmp_path, tactune):
    names = ("/cam1/depth/image", "/cam2/depth/image", "/cam2/color/image_raw")
    streams = [depth(names[0], "b_optical"), depth(names[1], "a_optical", 390), color(names[2], "c_optical")]
    path = make_recording(tmp_path / "take", streams)
    both = ("--topics", f"proximity.depth={names[1]}", "--topics", f"tactile.depth={names[0]}")
    same = (*both[:2], "--topics", f"tactile.depth={names[1]}")
    assert "one topic as the depth of both" in tactune("convert", path, tmp_path / "out", *same).sentence
    assert "--topics names no tactile.depth" in tactune("convert", path, tmp_path / "out", *both[:2]).sentence
    assert tactune("convert", path, tmp_path / "out", *both).status == 0
    with open_source(str(tmp_path / "out")) as source:
        frame = source.next_frame()
        assert (frame.proximity_depth[0, 0], frame.tactile_depth[0, 0]) == (390, 400)
        assert (frame.proximity_color == 90).all()
    wrong = f"{path}?proximity.depth={names[1]},proximity.color={names[0]},tactile.depth={names[0]}"
    assert f"the proximity colour is left out: {names[0]} has no colour" in first_frame(wrong)[2].message


def test_only_images_half_a_period_apart_by_their_own_stamps_are_a_frame(tmp_path):
    late = depth(TOUCH, "b_optical", 390, stamps_s=(0.0, 0.1, 0.26, 0.36), late_s=0.5)
    near = depth(NEAR, "a_optical", stamps_s=(0.0, 0.1, 0.2, 0.3))
    with open_source(str(make_recording(tmp_path / "take", [near, late]))) as source:
        pairs = [(int(f.proximity_depth[0, 0]), int(f.tactile_depth[0, 0])) for f in source]
        assert pairs == [(400, 390), (401, 391), (403, 392)]
        assert source.health().unmatched == 2
    stopped = depth(TOUCH, "b_optical", 390, stamps_s=(0.0, 0.1))
    with open_source(str(make_recording(tmp_path / "stopped", [near, stopped]))) as source:
        assert source.length == 2 and source.health().unmatched == 2
    ahead = depth(TOUCH, "b_optical", 390, stamps_s=(60.1, 60.2))
    with pytest.raises(SourceError, match=r"about 60 s apart; choose recordings of the same time"):
        open_source(str(make_recording(tmp_path / "ahead", [near, ahead])))


def rvl(image):
    """Compress as the paper's own program does, one pixel after another."""
    parts = []

    def put(number):
        while number > 7:
            parts.append(number & 7 | 8)
            number >>= 3
        parts.append(number)

    pixels, at, before = image.ravel().tolist(), 0, 0
    while at < len(pixels):
        run = next((n for n, value in enumerate(pixels[at:]) if value), len(pixels) - at)
        at += run
        put(run)
        run = next((n for n, value in enumerate(pixels[at:]) if not value), len(pixels) - at)
        put(run)
        for value in pixels[at : at + run]:
            step, before = value - before, value
            put(2 * step if step >= 0 else -2 * step - 1)
        at += run
    parts += [0] * (-len(parts) % 8)
    words = np.array(parts, np.uint32).reshape(-1, 8) << np.arange(28, -1, -4, dtype=np.uint32)
    return bytes(12) + np.array(image.shape[::-1], "<u4").tobytes() + words.sum(axis=1).astype("<u4").tobytes()


@pytest.mark.parametrize("hole", [np.s_[:0], np.s_[:3], np.s_[5:9, 4:], np.s_[-2:], np.s_[::2, ::2]])
def test_depth_compressed_as_rvl(tmp_path, hole):
    image = RNG.integers(1, 65535, (H, W)).astype(np.uint16)
    image[hole] = 0
    topic, info = "/l515/depth/image_rect_raw/compressedDepth", "/l515/depth/camera_info"
    how = "16UC1; compressedDepth rvl"
    near = depth(topic, "a_optical", images=[rvl(image)] * 3, encoding=how, info=info)
    _, frame, _ = first_frame(make_recording(tmp_path / "take", [near, TWO[1]]))
    np.testing.assert_array_equal(frame.proximity_depth, image)


@pytest.mark.parametrize("empty_infos", [0, 3])
def test_a_lens_that_no_topic_states_comes_from_a_file_and_is_kept(tmp_path, monkeypatch, empty_infos):
    lacking = {"empty_infos": empty_infos} if empty_infos else {"info": None}
    touch = depth(TOUCH, "b_optical", 390, **lacking)
    path = make_recording(tmp_path / "take", [TWO[0], touch])
    with pytest.raises(SourceError, match=r"tactile\.info=lens\.yaml"):
        open_source(str(path))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "K.txt").write_text("31 0 15 0 32 11 0 0 1")
    with pytest.raises(SourceError, match=r"there is neither a topic nor a file .*/X\.txt"):
        open_source(f"{path}?tactile.info=X.txt")
    for name in (f"{path}?tactile.info=K.txt", str(path)):
        rig, frame, _ = first_frame(name)
        lens = rig.tactile.intrinsics
        assert (lens.fx, lens.fy, lens.cx, lens.cy) == (31, 32, 15, 11) and rig.proximity.intrinsics.fx == 30
        assert frame.tactile_depth[0, 0] == 390


def test_a_colour_whose_lens_is_empty_is_left_out_and_images_without_stamps_have_the_recorders(tmp_path):
    colour = color("/l515/color/image_raw", "c_optical", empty_infos=3)
    rig, _, health = first_frame(make_recording(tmp_path / "take", [*TWO[:2], colour]))
    assert rig.proximity_color is None and "colour is left out" in health.message
    path = make_recording(tmp_path / "bare", [replace(stream, stamped=False) for stream in TWO])
    with open_source(str(path)) as source:
        assert [frame.proximity_time_s for frame in source] == pytest.approx([1000, 1000.1, 1000.2])
        assert "no time stamps" in source.health().message


def test_a_transform_that_is_not_filled_in_is_no_pose(tmp_path):
    rig, _, health = first_frame(
        make_recording(tmp_path / "take", TWO, (("a_optical", "b_optical", (1, 0, 0), (0.0,) * 4),))
    )
    assert rig.T_proximity_tactile is None and not health.ok


def test_depth_and_colour_of_an_unknown_encoding_are_named_and_the_rest_is_shown(tmp_path):
    near = replace(TWO[0], encoding="Z16")
    rig, _, health = first_frame(make_recording(tmp_path / "depth", [near, TWO[1]]))
    assert not rig.has_proximity and f"{near.topic} ('Z16')" in health.message
    colour = color("/l515/color/image_raw", "c_optical", encoding="RGB8")
    rig, _, health = first_frame(make_recording(tmp_path / "colour", [*TWO[:2], colour]))
    assert rig.has_proximity and "'RGB8'" in health.message


def test_a_database_that_computes_its_messages_is_refused(tmp_path):
    path = file_in(make_recording(tmp_path / "take", TWO, kind="sqlite"))
    with closing(sqlite3.connect(path)) as database:
        database.execute("ALTER TABLE messages RENAME TO kept")
        database.execute("CREATE VIEW messages AS SELECT * FROM kept")
    with pytest.raises(SourceError, match="computes"):
        open_source(str(path))
