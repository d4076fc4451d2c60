"""RealSense bags: a real one against the camera maker's own reader, and made-up ones with two cameras."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from tactune.core.errors import SourceError
from tactune.core.intrinsics import Distortion
from tactune.core.sources.bag import BagSource
from tactune.core.sources.folder import FolderSource, export_folder

DATA = Path(os.environ.get("TACTUNE_TEST_DATA", Path(__file__).resolve().parents[2].parent / "shared/data"))
REAL_BAG = DATA / "realsense_bag/single_depth_color_640x480.bag"
needs_real_bag = pytest.mark.skipif(not REAL_BAG.is_file(), reason=f"no recording {REAL_BAG}")

STORE = get_typestore(Stores.ROS1_NOETIC)
STORE.register(
    get_types_from_msg("uint32 fps\nstring encoding\nbool is_recommended\n", "realsense_msgs/msg/StreamInfo")
)
T: Any = STORE.types
SECOND = 1_000_000_000


# --- making bags -----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Images:
    """One stream: its images with the seconds at which each was recorded and stamped."""

    images: list[np.ndarray]
    recorded_s: list[float]
    stamps_s: list[float]
    encoding: str
    clock: str | None = "Hardware Clock"
    lens: str = "None"
    D: tuple[float, ...] = (0.0,) * 5
    K: tuple[float, float, float, float] = (20.0, 21.0, 3.5, 2.5)
    pose: tuple[Rotation, tuple[float, float, float]] = (Rotation.identity(), (0.0, 0.0, 0.0))
    tf: str | None = "0"
    padding: int = 0
    big_endian: bool = False
    size: tuple[int, int] | None = None
    missing_bytes: int = 0


@dataclass(frozen=True)
class Device:
    name: str
    depth: Images | None
    color: Images | None = None
    unit_topic: str | None = "Depth Units"
    unit_m: float = 0.00025
    without: set[str] = field(default_factory=set)


def depth_images(seed: int, times: list[float], **changes: Any) -> Images:
    rng = np.random.default_rng(seed)
    images = [rng.integers(0, 65536, (6, 8)).astype(np.uint16) for _ in times]
    return replace(Images(images, times, times, "mono16"), **changes)


def color_images(seed: int, times: list[float], **changes: Any) -> Images:
    rng = np.random.default_rng(seed)
    images = [rng.integers(0, 256, (10, 12, 3)).astype(np.uint8) for _ in times]
    return replace(Images(images, times, times, "rgb8"), **changes)


class BagMaker:
    """Writes what librealsense writes, message by message in the order of time."""

    def __init__(self) -> None:
        self.messages: list[tuple[int, str, str, Any]] = []

    def add(self, recorded_s: float, topic: str, kind: str, **fields: Any) -> None:
        self.messages.append((round(recorded_s * SECOND), topic, kind, T[kind](**fields)))

    def add_device(self, number: int, device: Device) -> None:
        for key, value in (("Name", device.name), ("Serial Number", f"sn{number}")):
            self.add(0, f"/device_{number}/info", "diagnostic_msgs/msg/KeyValue", key=key, value=value)
        if device.unit_topic:
            topic = f"/device_{number}/sensor_0/option/{device.unit_topic}/value"
            self.add(0, topic, "std_msgs/msg/Float32", data=device.unit_m)
        for sensor, (name, stream) in enumerate((("Depth_0", device.depth), ("Color_0", device.color))):
            if stream is not None:
                self.add_stream(f"/device_{number}/sensor_{sensor}/{name}", stream, device.without)

    def add_stream(self, topic: str, stream: Images, without: set[str]) -> None:
        header = lambda stamp: T["std_msgs/msg/Header"](  # noqa: E731
            seq=0,
            stamp=T["builtin_interfaces/msg/Time"](
                sec=int(round(stamp * SECOND) // SECOND), nanosec=int(round(stamp * SECOND) % SECOND)
            ),
            frame_id="0",
        )
        height, width = stream.size or stream.images[0].shape[:2]
        fx, fy, cx, cy = stream.K
        if "info" not in without:
            self.add(0, f"{topic}/info", "realsense_msgs/msg/StreamInfo", fps=15, encoding="x", is_recommended=False)
        if "camera_info" not in without:
            self.add(
                0,
                f"{topic}/info/camera_info",
                "sensor_msgs/msg/CameraInfo",
                header=header(0.0),
                height=height,
                width=width,
                distortion_model=stream.lens,
                D=np.array(stream.D),
                K=np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1], float),
                R=np.zeros(9),
                P=np.zeros(12),
                binning_x=0,
                binning_y=0,
                roi=T["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False),
            )
        if stream.tf is not None:
            rotation, translation = stream.pose
            self.add(
                0,
                f"{topic}/tf/{stream.tf}",
                "geometry_msgs/msg/Transform",
                translation=T["geometry_msgs/msg/Vector3"](*translation),
                rotation=T["geometry_msgs/msg/Quaternion"](*rotation.as_quat()),
            )
        for image, recorded_s, stamp_s in zip(stream.images, stream.recorded_s, stream.stamps_s, strict=True):
            array = image.astype(">u2") if stream.big_endian else image
            rows = np.ascontiguousarray(array).view(np.uint8).reshape(image.shape[0], -1)
            rows = np.pad(rows, ((0, 0), (0, stream.padding)), constant_values=7)
            self.add(
                recorded_s,
                f"{topic}/image/data",
                "sensor_msgs/msg/Image",
                header=header(stamp_s),
                height=image.shape[0],
                width=image.shape[1],
                encoding=stream.encoding,
                is_bigendian=int(stream.big_endian),
                step=rows.shape[1],
                data=rows.reshape(-1)[: rows.size - stream.missing_bytes],
            )
            if stream.clock is not None:
                for key, value in (("system_time", "1"), ("timestamp_domain", stream.clock)):
                    kind = "diagnostic_msgs/msg/KeyValue"
                    self.add(recorded_s, f"{topic}/image/metadata", kind, key=key, value=value)

    def write(self, path: Path, compress: bool = False) -> Path:
        writer = Writer(path)
        writer.chunk_threshold = 500
        if compress:
            writer.set_compression(Writer.CompressionFormat.LZ4)
        with writer:
            connections: dict[str, Any] = {}
            for recorded_ns, topic, kind, message in sorted(self.messages, key=lambda entry: entry[0]):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
                writer.write(connections[topic], recorded_ns, STORE.serialize_ros1(message, kind))
        return path


def make_bag(path: Path, *devices: Device, compress: bool = False) -> Path:
    maker = BagMaker()
    for number, device in enumerate(devices):
        maker.add_device(number, device)
    return maker.write(path, compress)


D405 = Device("Intel RealSense D405", depth_images(1, [1.0, 2.0, 3.0]), unit_m=0.0001)
L515 = Device("Intel RealSense L515", depth_images(2, [1.1, 2.1, 2.9]), color_images(3, [1.0, 2.0, 3.0]))


Opener = Callable[..., BagSource]


@pytest.fixture
def open_bag() -> Iterator[Opener]:
    """Opens bags and closes them after the test."""
    with ExitStack() as stack:
        yield lambda path, progress=None: stack.enter_context(BagSource(path, progress))


@pytest.fixture
def two_cameras(tmp_path: Path) -> Path:
    return make_bag(tmp_path / "two.bag", D405, L515)


# --- two cameras -----------------------------------------------------------------------------------


@pytest.mark.parametrize("compress", [False, True])
def test_two_cameras_are_read_pixel_for_pixel_in_any_order(tmp_path: Path, compress: bool) -> None:
    path = make_bag(tmp_path / "two.bag", D405, L515, compress=compress)
    with BagSource(path) as source:
        assert source.length == 3
        assert source.frame_rate_hz == 15.0
        assert source.health().message == ""
        assert source.health().ok
        for index in (2, 0, 1, 1):
            frame = source.read(index)
            assert frame.sequence == index
            np.testing.assert_array_equal(frame.proximity_depth, L515.depth.images[index])
            np.testing.assert_array_equal(frame.proximity_color, L515.color.images[index])
            np.testing.assert_array_equal(frame.tactile_depth, D405.depth.images[index])
            assert frame.tactile_color is None
            frame.check_against(source.rig)


def test_the_rig_is_the_recordings(open_bag: Opener, two_cameras: Path) -> None:
    rig = open_bag(two_cameras).rig
    assert (rig.proximity.model, rig.proximity.serial) == ("Intel RealSense L515", "sn1")
    assert (rig.tactile.model, rig.tactile.serial) == ("Intel RealSense D405", "sn0")
    assert rig.proximity.depth_unit_m == float(np.float32(0.00025))
    assert rig.tactile.depth_unit_m == float(np.float32(0.0001))
    lens = rig.proximity.intrinsics
    assert (lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy) == (8, 6, 20.0, 21.0, 3.5, 2.5)
    assert rig.T_proximity_tactile is None
    assert rig.proximity_color is not None
    assert rig.proximity_color.intrinsics.shape == (10, 12)


def test_without_an_l515_the_first_device_is_proximity(open_bag: Opener, tmp_path: Path) -> None:
    other = replace(L515, name="Intel RealSense D435")
    source = open_bag(make_bag(tmp_path / "two.bag", D405, other))
    assert source.rig.proximity.model == "Intel RealSense D405"
    assert source.rig.tactile.model == "Intel RealSense D435"


@pytest.mark.parametrize(
    ("clocks", "expected", "times_s"),
    [
        (("Global Time", "Global Time"), [2, 0], [(50.0, 49.9), (60.0, 60.2)]),
        (("System Time", "System Time"), [2, 0], [(50.0, 49.9), (60.0, 60.2)]),
        (("Hardware Clock", "Hardware Clock"), [1, 2], [(1.0, 1.4), (2.0, 2.2)]),
        (("Global Time", "System Time"), [1, 2], [(1.0, 1.4), (2.0, 2.2)]),
        ((None, None), [1, 2], [(1.0, 1.4), (2.0, 2.2)]),
    ],
)
def test_cameras_are_paired_on_a_clock_that_they_share(
    open_bag: Opener, tmp_path: Path, clocks: tuple[str, str], expected: list[int], times_s: list[tuple[float, float]]
) -> None:
    proximity = depth_images(4, [1.0, 2.0], stamps_s=[50.0, 60.0], clock=clocks[0])
    tactile = depth_images(5, [0.4, 1.4, 2.2], stamps_s=[60.2, 70.0, 49.9], clock=clocks[1])
    path = make_bag(tmp_path / "two.bag", Device("L515", proximity), Device("D405", tactile))
    frames = list(open_bag(path))
    for frame, index, (proximity_s, tactile_s) in zip(frames, expected, times_s, strict=True):
        np.testing.assert_array_equal(frame.tactile_depth, tactile.images[index])
        assert frame.proximity_time_s == pytest.approx(proximity_s, abs=1e-9)
        assert frame.tactile_time_s == pytest.approx(tactile_s, abs=1e-9)
        assert frame.skew_s == pytest.approx(tactile_s - proximity_s)


def test_one_devices_own_clock_pairs_its_colour(open_bag: Opener, tmp_path: Path) -> None:
    depth = depth_images(4, [1.0, 2.0, 3.0], stamps_s=[101.0, 102.0, 103.0])
    color = color_images(5, [1.0, 2.0, 3.0], stamps_s=[102.1, 103.1, 104.1])
    source = open_bag(make_bag(tmp_path / "one.bag", Device("L515", depth, color)))
    for index, expected in enumerate([0, 0, 1]):
        np.testing.assert_array_equal(source.read(index).proximity_color, color.images[expected])


def test_images_recorded_at_the_same_moment_are_told_apart(open_bag: Opener, tmp_path: Path) -> None:
    depth = depth_images(4, [1.0, 1.0, 1.0], stamps_s=[101.0, 102.0, 103.0])
    source = open_bag(make_bag(tmp_path / "one.bag", Device("L515", depth)))
    for index in range(3):
        np.testing.assert_array_equal(source.read(index).proximity_depth, depth.images[index])


def test_the_colour_cameras_pose_goes_by_way_of_the_reference(open_bag: Opener, tmp_path: Path) -> None:
    turn_depth, turn_color = Rotation.from_euler("xyz", [0.3, -0.2, 0.1]), Rotation.from_euler("xyz", [-0.1, 0.5, 0.2])
    depth = depth_images(4, [1.0], pose=(turn_depth, (0.01, 0.02, 0.03)))
    color = color_images(5, [1.0], pose=(turn_color, (-0.04, 0.05, 0.06)))
    source = open_bag(make_bag(tmp_path / "one.bag", Device("L515", depth, color)))
    assert source.rig.proximity_color is not None
    T_c_d = np.asarray(source.rig.proximity_color.T_color_depth)
    at_reference = np.array([0.3, -0.2, 0.7])
    in_depth = turn_depth.apply(at_reference) + np.array([0.01, 0.02, 0.03])
    in_color = turn_color.apply(at_reference) + np.array([-0.04, 0.05, 0.06])
    np.testing.assert_allclose(T_c_d[:3, :3] @ in_depth + T_c_d[:3, 3], in_color, atol=1e-12)


def test_tactile_colour_belongs_to_the_tactile_depth_image(open_bag: Opener, tmp_path: Path) -> None:
    lens = {"K": (20.0, 21.0, 3.5, 2.5)}
    colors = [np.full((6, 8, 3), value, np.uint8) for value in (10, 20, 30)]
    tactile = Device("D405", depth_images(5, [1.0, 2.0, 3.0]), color_images(6, [1.0, 2.0, 3.0], images=colors, **lens))
    source = open_bag(make_bag(tmp_path / "two.bag", Device("L515", depth_images(4, [2.9])), tactile))
    frame = source.read(0)
    np.testing.assert_array_equal(frame.tactile_depth, tactile.depth.images[2])
    assert frame.tactile_color is not None
    assert (frame.tactile_color == 30).all()


def test_a_colour_camera_beside_depth_is_not_aligned_even_with_the_same_lens(open_bag: Opener, tmp_path: Path) -> None:
    pose = (Rotation.identity(), (0.015, 0.0, 0.0))
    color = Images([np.full((6, 8, 3), 9, np.uint8)], [1.0], [1.0], "rgb8", pose=pose)
    rig = open_bag(make_bag(tmp_path / "one.bag", Device("L515", depth_images(4, [1.0]), color))).rig
    assert rig.proximity_color is not None
    assert rig.proximity_color.T_color_depth[0][3] == 0.015


def test_colour_in_the_depth_cameras_own_pixels_needs_no_colour_camera(open_bag: Opener, tmp_path: Path) -> None:
    color = Images([np.full((6, 8, 3), 9, np.uint8)], [1.0], [1.0], "rgb8")
    path = make_bag(
        tmp_path / "two.bag",
        Device("L515", depth_images(4, [1.0]), color),
        Device("D405", depth_images(5, [1.0]), color),
    )
    source = open_bag(path)
    assert source.rig.proximity_color is None
    frame = source.read(0)
    frame.check_against(source.rig)
    assert frame.tactile_color is not None
    assert (frame.tactile_color == 9).all()


def test_tactile_colour_is_brought_to_tactile_depth_pixels(open_bag: Opener, tmp_path: Path) -> None:
    depth = np.full((6, 8), 1000, np.uint16)
    depth[0, :] = 0
    depth[5, 3] = 65535
    color = color_images(6, [1.0], K=(20.0, 21.0, 3.5, 2.5), pose=(Rotation.identity(), (0.2, 0.0, 0.0)))
    tactile = Device("D405", Images([depth], [1.0], [1.0], "mono16"), color, unit_m=0.001)
    frame = open_bag(make_bag(tmp_path / "two.bag", Device("L515", depth_images(5, [1.0])), tactile)).read(0)
    expected = np.zeros((6, 8, 3), np.uint8)
    for v in range(1, 6):
        for u in range(8):
            x, y = (u - 3.5) / 20.0 + 0.2, (v - 2.5) / 21.0
            expected[v, u] = color.images[0][round(y * 21.0 + 2.5), round(x * 20.0 + 3.5)]
    expected[5, 3] = 0
    assert frame.tactile_color is not None
    np.testing.assert_array_equal(frame.tactile_color, expected)


def test_a_bag_can_be_handed_on_as_a_folder(open_bag: Opener, two_cameras: Path, tmp_path: Path) -> None:
    source = open_bag(two_cameras)
    assert export_folder(source, tmp_path / "out") == 3
    copy = FolderSource(tmp_path / "out")
    assert copy.rig == source.rig
    for index in range(3):
        np.testing.assert_array_equal(copy.read(index).tactile_depth, source.read(index).tactile_depth)
        assert copy.read(index).skew_s == source.read(index).skew_s


def test_indexing_tells_how_far_it_is(open_bag: Opener, two_cameras: Path) -> None:
    told: list[tuple[float, str]] = []
    open_bag(two_cameras, lambda share, words: told.append((share, words)))
    assert told[-1] == (1.0, "indexing two.bag: image 9 of 9")


# --- formats ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        ("None", Distortion.NONE),
        ("Brown Conrady", Distortion.BROWN_CONRADY),
        ("Modified Brown Conrady", Distortion.MODIFIED_BROWN_CONRADY),
        ("Inverse Brown Conrady", Distortion.INVERSE_BROWN_CONRADY),
    ],
)
def test_lens_models_keep_their_names_and_coefficients(
    open_bag: Opener, tmp_path: Path, model: str, expected: Distortion
) -> None:
    depth = depth_images(4, [1.0], lens=model, D=(0.1, -0.2, 0.3, -0.4, 0.5))
    lens = open_bag(make_bag(tmp_path / "one.bag", Device("D435", depth))).rig.proximity.intrinsics
    assert lens.distortion is expected
    assert lens.coefficients == (0.1, -0.2, 0.3, -0.4, 0.5)


@pytest.mark.parametrize(("encoding", "order"), [("rgb8", [0, 1, 2]), ("bgr8", [2, 1, 0])])
@pytest.mark.parametrize("alpha", [False, True])
def test_colour_orders(open_bag: Opener, tmp_path: Path, encoding: str, order: list[int], alpha: bool) -> None:
    rgb = color_images(7, [1.0]).images[0]
    stored = rgb[:, :, order]
    if alpha:
        stored = np.dstack([stored, np.full(rgb.shape[:2], 255, np.uint8)])
        encoding = encoding.replace("8", "a8")
    color = color_images(7, [1.0], images=[stored], encoding=encoding, padding=5)
    frame = open_bag(make_bag(tmp_path / "one.bag", Device("L515", depth_images(4, [1.0]), color))).read(0)
    np.testing.assert_array_equal(frame.proximity_color, rgb)


@pytest.mark.parametrize(("encoding", "luma", "chroma"), [("YUYV", 0, 1), ("yuv422", 1, 0)])
def test_colour_as_luma_and_chroma(open_bag: Opener, tmp_path: Path, encoding: str, luma: int, chroma: int) -> None:
    stored = np.zeros((10, 12, 2), np.uint8)
    stored[..., luma] = 81
    stored[:, 0::2, chroma], stored[:, 1::2, chroma] = 90, 240  # U, V of a strong red
    color = color_images(7, [1.0], images=[stored], encoding=encoding)
    frame = open_bag(make_bag(tmp_path / "one.bag", Device("L515", depth_images(4, [1.0]), color))).read(0)
    red, green, blue = frame.proximity_color[5, 5].astype(int)
    assert red > 240
    assert green < 15
    assert blue < 15


def test_grey_colour(open_bag: Opener, tmp_path: Path) -> None:
    grey = color_images(7, [1.0]).images[0][:, :, 0]
    color = color_images(7, [1.0], images=[grey], encoding="8UC1")
    frame = open_bag(make_bag(tmp_path / "one.bag", Device("L515", depth_images(4, [1.0]), color))).read(0)
    np.testing.assert_array_equal(frame.proximity_color, np.dstack([grey] * 3))


@pytest.mark.parametrize("changes", [{"padding": 6}, {"big_endian": True}, {"encoding": "16UC1"}])
def test_depth_layouts(open_bag: Opener, tmp_path: Path, changes: dict[str, Any]) -> None:
    depth = depth_images(4, [1.0], **changes)
    frame = open_bag(make_bag(tmp_path / "one.bag", Device("L515", depth))).read(0)
    np.testing.assert_array_equal(frame.proximity_depth, depth.images[0])
    assert frame.proximity_depth.dtype == np.dtype("=u2")


@pytest.mark.parametrize("spelling", ["Depth Units", "Depth_Units"])
def test_both_spellings_of_the_depth_unit(open_bag: Opener, tmp_path: Path, spelling: str) -> None:
    device = replace(D405, unit_topic=spelling, unit_m=0.002)
    assert open_bag(make_bag(tmp_path / "one.bag", device)).rig.proximity.depth_unit_m == float(np.float32(0.002))


# --- one camera ------------------------------------------------------------------------------------


def test_one_camera_is_for_viewing_only(open_bag: Opener, tmp_path: Path) -> None:
    source = open_bag(make_bag(tmp_path / "one.bag", L515))
    assert source.health().message == "this recording has one depth camera: for viewing only"
    assert source.rig.tactile.model == "none"
    assert source.rig.tactile.intrinsics == source.rig.proximity.intrinsics
    frame = source.read(1)
    assert not frame.tactile_depth.any()
    assert frame.tactile_color is None
    assert frame.skew_s == 0.0
    frame.check_against(source.rig)


def test_without_colour_the_image_is_black_and_that_is_said(open_bag: Opener, tmp_path: Path) -> None:
    source = open_bag(make_bag(tmp_path / "two.bag", replace(L515, color=None), D405))
    assert source.health().message == "this recording has no proximity colour: its image stays black"
    assert not source.health().ok
    frame = source.read(0)
    frame.check_against(source.rig)
    assert not frame.proximity_color.any()


# --- refusals --------------------------------------------------------------------------------------

ONE = [1.0]
BAD: dict[str, tuple[list[Device], str]] = {
    "no depth": ([Device("L515", None, color_images(1, ONE))], "it holds no depth images"),
    "three cameras": (
        [D405, L515, replace(D405, name="D415")],
        r"has 3 depth cameras \(Intel RealSense D405, Intel RealSense L515, D415\); record one or two",
    ),
    "no unit": ([replace(D405, unit_topic=None)], "the depth unit is missing"),
    "unit of zero": ([replace(D405, unit_m=0.0)], "the depth unit is 0.0 m"),
    "no lens": ([replace(D405, without={"camera_info"})], r"Depth_0/info/camera_info is missing"),
    "no stream info": ([replace(D405, without={"info"})], r"Depth_0/info is missing"),
    "unknown lens": ([Device("D405", depth_images(1, ONE, lens="Ftheta"))], "the lens model 'Ftheta'; known are none"),
    "focal length of zero": ([Device("D405", depth_images(1, ONE, K=(0.0, 1.0, 1.0, 1.0)))], "fx of the lens"),
    "no pose": (
        [Device("L515", depth_images(1, ONE), color_images(1, ONE, tf=None))],
        r"the pose of /device_0/sensor_1/Color_0 to /device_0/sensor_0/Depth_0 is missing",
    ),
    "no common reference": (
        [Device("L515", depth_images(1, ONE), color_images(1, ONE, tf="1"))],
        r"the pose of .* is missing",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_a_recording_that_lacks_something_is_refused_in_one_sentence(tmp_path: Path, case: str) -> None:
    devices, sentence = BAD[case]
    path = make_bag(tmp_path / "bad.bag", *devices)
    with pytest.raises(SourceError, match=sentence) as caught:
        BagSource(path)
    assert "bad.bag" in str(caught.value)
    assert "record" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("device", "sentence"),
    [
        (Device("L515", depth_images(1, ONE, encoding="32FC1")), "'32FC1', not as 16 bit depth"),
        (Device("L515", depth_images(1, ONE, size=(6, 9))), "an image of 8 x 6 pixels, .* 9 x 6"),
        (Device("L515", depth_images(1, ONE, missing_bytes=16)), "an image of 80 bytes, too few for its size"),
        (Device("L515", depth_images(1, ONE), color_images(1, ONE, encoding="jpeg")), "'jpeg'; known are rgb8"),
        (Device("L515", depth_images(1, ONE), color_images(1, ONE, encoding="rgba8")), "too few for its size"),
    ],
)
def test_an_image_that_is_not_as_stated_is_refused(
    open_bag: Opener, tmp_path: Path, device: Device, sentence: str
) -> None:
    source = open_bag(make_bag(tmp_path / "bad.bag", device))
    with pytest.raises(SourceError, match=sentence):
        source.read(0)


def test_a_path_that_is_no_bag_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"there is no file .*missing\.bag"):
        BagSource(tmp_path / "missing.bag")
    (tmp_path / "text.bag").write_text("hello\n")
    with pytest.raises(SourceError, match=r"text\.bag is no readable ROS 1 bag \(File magic is invalid"):
        BagSource(tmp_path / "text.bag")
    (tmp_path / "empty.bag").write_bytes(b"")
    with pytest.raises(SourceError, match=r"empty\.bag is no readable ROS 1 bag"):
        BagSource(tmp_path / "empty.bag")


def test_damage_is_always_told_as_a_source_error(two_cameras: Path, tmp_path: Path) -> None:
    whole = two_cameras.read_bytes()
    rng = np.random.default_rng(0)
    damaged = tmp_path / "damaged.bag"
    refused = 0
    for attempt in range(120):
        data = bytearray(whole)
        start = int(rng.integers(14, len(data)))
        if attempt % 2:
            del data[start:]
        else:
            data[start : start + 16] = rng.bytes(16)
        damaged.write_bytes(data)
        try:
            with BagSource(damaged) as source:
                list(source)
        except SourceError as error:
            refused += 1
            assert "\n" not in str(error)
    assert refused >= 60


def test_a_closed_source_says_so(open_bag: Opener, two_cameras: Path) -> None:
    source = open_bag(two_cameras)
    source.close()
    source.close()
    with pytest.raises(SourceError, match=r"two\.bag is closed; open it again"):
        source.read(0)


# --- real data -------------------------------------------------------------------------------------


@needs_real_bag
def test_the_real_bag_is_what_is_known_of_it() -> None:
    with BagSource(REAL_BAG) as source:
        assert (source.rig.proximity.model, source.rig.proximity.serial) == ("Intel RealSense D435", "728612070259")
        assert source.rig.proximity.depth_unit_m == pytest.approx(0.001, rel=1e-6)
        assert source.frame_rate_hz == 6.0
        assert [round(frame.proximity_time_s, 6) for frame in source] == [360.815089, 360.981765]
        source.seek(0)
        assert [int(frame.proximity_depth.sum(dtype=np.int64)) for frame in source] == [357542766, 358061319]


@needs_real_bag
def test_the_real_bag_is_as_the_camera_makers_reader_sees_it() -> None:
    rs = pytest.importorskip(
        "pyrealsense2",
        reason="pyrealsense2 (extra realsense) or its library libusb-1.0 is missing",
        exc_type=ImportError,
    )
    depth_frames, color_frames = [], []
    device = rs.context().load_device(str(REAL_BAG))
    device.as_playback().set_real_time(False)
    queue = rs.frame_queue(16, keep_frames=True)
    profiles = {}
    for sensor in device.query_sensors():
        for profile in sensor.get_stream_profiles():
            profiles[profile.stream_name()] = profile.as_video_stream_profile()
        if sensor.is_depth_sensor():
            unit_m = sensor.as_depth_sensor().get_depth_scale()
        sensor.open(sensor.get_stream_profiles())
        sensor.start(queue)
    deadline = time.monotonic() + 30
    while len(depth_frames) < 2 or not color_frames:
        assert time.monotonic() < deadline, "the camera maker's reader gave too few frames"
        frame = queue.poll_for_frame()
        if not frame:
            time.sleep(0.01)
            continue
        frames = depth_frames if frame.profile.stream_name() == "Depth" else color_frames
        frames.append((frame.timestamp * 1e-3, np.array(frame.get_data())))

    with BagSource(REAL_BAG) as source:
        rig = source.rig
        assert source.length == len(depth_frames)
        for ours, (time_s, depth) in zip(source, sorted(depth_frames, key=lambda entry: entry[0]), strict=True):
            np.testing.assert_array_equal(ours.proximity_depth, depth)
            np.testing.assert_array_equal(ours.proximity_color, color_frames[0][1])
            assert ours.proximity_time_s == pytest.approx(time_s, abs=1e-6)
    assert rig.proximity.depth_unit_m == unit_m
    assert rig.proximity_color is not None
    for ours, name in ((rig.proximity.intrinsics, "Depth"), (rig.proximity_color.intrinsics, "Color")):
        theirs = profiles[name].get_intrinsics()
        assert (ours.width, ours.height) == (theirs.width, theirs.height)
        assert (ours.fx, ours.fy, ours.cx, ours.cy) == (theirs.fx, theirs.fy, theirs.ppx, theirs.ppy)
        assert theirs.model == getattr(rs.distortion, ours.distortion.value)
        assert list(ours.coefficients) == theirs.coeffs
    extrinsics = profiles["Depth"].get_extrinsics_to(profiles["Color"])
    T_c_d = np.asarray(rig.proximity_color.T_color_depth)
    np.testing.assert_allclose(T_c_d[:3, :3], np.reshape(extrinsics.rotation, (3, 3)).T, atol=1e-6)
    np.testing.assert_allclose(T_c_d[:3, 3], extrinsics.translation, atol=1e-8)
