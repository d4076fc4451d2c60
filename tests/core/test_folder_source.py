"""Folders of images: what is read, what is refused, and that an export gives back every bit."""

from __future__ import annotations

import json
import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from tactune.core.errors import ExportError, FrameError, SourceError
from tactune.core.frames import ColorCamera, DepthCamera, GroundTruth, Rig, SensorFrame
from tactune.core.intrinsics import Distortion, Intrinsics
from tactune.core.rig_file import load_rig, save_rig
from tactune.core.sources.base import FrameSource, SeekableSource
from tactune.core.sources.folder import FolderSource, export_folder

DATA = Path(os.environ.get("TACTUNE_TEST_DATA", Path(__file__).resolve().parents[2].parent / "shared/data"))
UNIT_M = 0.00025
POSE = ((0.0, -1.0, 0.0, 0.04), (1.0, 0.0, 0.0, -0.01), (0.0, 0.0, 1.0, 0.1 / 3), (0.0, 0.0, 0.0, 1.0))


def lens(width: int, height: int, **extra: object) -> Intrinsics:
    return Intrinsics(width=width, height=height, fx=460.1, fy=1 / 3, cx=width / 2, cy=-0.5, **extra)


RIG = Rig(
    proximity=DepthCamera(model="L515", serial="f0", intrinsics=lens(7, 5), depth_unit_m=UNIT_M),
    tactile=DepthCamera(
        model="D405",
        intrinsics=lens(
            6, 4, distortion=Distortion.INVERSE_BROWN_CONRADY, coefficients=(0.1, 0.2 / 3, -1e-17, 4.0, 5.0)
        ),
        depth_unit_m=0.0001,
    ),
    proximity_color=ColorCamera(intrinsics=lens(9, 8), T_color_depth=POSE),
    T_proximity_tactile=POSE,
)


def make_frame(seed: int, rig: Rig = RIG, **changes: object) -> SensorFrame:
    rng = np.random.default_rng(seed)
    shape, tactile = rig.proximity.intrinsics.shape, rig.tactile.intrinsics.shape
    truth_m = rng.uniform(0.1, 0.4, shape).astype(np.float32)
    truth_m[0, 0] = np.nan
    values: dict[str, object] = {
        "sequence": 100 + seed,
        "proximity_depth": rng.integers(0, 65536, shape).astype(np.uint16),
        "tactile_depth": rng.integers(0, 65536, tactile).astype(np.uint16),
        "proximity_color": rng.integers(0, 256, (*rig.proximity_color_shape, 3)).astype(np.uint8),
        "tactile_color": rng.integers(0, 256, (*tactile, 3)).astype(np.uint8),
        "proximity_time_s": 1.7e9 + seed / 7,
        "tactile_time_s": 1.7e9 + seed / 7 + 0.0031,
        "truth": GroundTruth(rng.random(shape) < 0.5, truth_m),
    }
    return SensorFrame(**(values | changes))  # type: ignore[arg-type]


class ListSource(SeekableSource):
    def __init__(self, frames: list[SensorFrame], rig: Rig = RIG, reference: SensorFrame | None = None) -> None:
        super().__init__("list", rig, len(frames))
        self.frames = frames
        self.untouched = reference

    def read(self, index: int) -> SensorFrame:
        return self.frames[index]

    def reference(self) -> SensorFrame | None:
        return self.untouched


class LiveSource(FrameSource):
    name = "live"
    rig = RIG  # type: ignore[assignment]

    def next_frame(self) -> SensorFrame | None:
        return make_frame(1)


def assert_same(one: SensorFrame, other: SensorFrame) -> None:
    for name in ("proximity_depth", "tactile_depth", "proximity_color"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert (one.sequence, one.proximity_time_s, one.tactile_time_s) == (
        other.sequence,
        other.proximity_time_s,
        other.tactile_time_s,
    )
    assert (one.tactile_color is None) == (other.tactile_color is None)
    if one.tactile_color is not None:
        np.testing.assert_array_equal(one.tactile_color, other.tactile_color)
    assert (one.truth is None) == (other.truth is None)
    if one.truth is not None and other.truth is not None:
        np.testing.assert_array_equal(one.truth.contact, other.truth.contact)
        assert (one.truth.depth_m is None) == (other.truth.depth_m is None)
        if one.truth.depth_m is not None and other.truth.depth_m is not None:
            assert other.truth.depth_m.dtype == np.float32
            np.testing.assert_array_equal(one.truth.depth_m, other.truth.depth_m)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Two frames with everything that a recording can hold."""
    path = tmp_path / "recording"
    export_folder(ListSource([make_frame(0), make_frame(1)], reference=make_frame(9)), path)
    return path


# --- round trip ------------------------------------------------------------------------------------


def test_an_export_gives_back_every_bit(tmp_path: Path) -> None:
    frames = [
        make_frame(0),
        make_frame(1, tactile_color=None, truth=None),
        make_frame(2, truth=GroundTruth(np.zeros((5, 7), bool))),
    ]
    reference = make_frame(3, sequence=4, truth=None)
    assert export_folder(ListSource(frames, reference=reference), tmp_path / "out") == 3
    with FolderSource(tmp_path / "out") as source:
        assert source.rig == RIG
        assert source.length == 3
        read = list(source)
        for before, after in zip(frames, read, strict=True):
            assert_same(before, after)
        untouched = source.reference()
    assert untouched is not None
    assert_same(reference, untouched)


def test_truth_on_whole_counts_needs_the_png_only(tmp_path: Path) -> None:
    counts = np.arange(35, dtype=np.uint16).reshape(5, 7) * 1800
    depth_m = np.where(counts > 0, counts.astype(np.float32) * np.float32(UNIT_M), np.float32(np.nan))
    frame = make_frame(0, truth=GroundTruth(counts > 9, depth_m))
    export_folder(ListSource([frame]), tmp_path / "out")
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "out/000000/truth_depth.png"), -1), counts)
    assert not (tmp_path / "out/000000/truth_depth.npy").exists()
    assert_same(frame, FolderSource(tmp_path / "out").read(0))


def test_fine_truth_is_rounded_in_the_png_for_other_programs(recording: Path) -> None:
    truth = make_frame(0).truth
    assert truth is not None
    assert truth.depth_m is not None
    counts = cv2.imread(str(recording / "000000/truth_depth.png"), cv2.IMREAD_UNCHANGED)
    assert counts.dtype == np.uint16
    assert counts[0, 0] == 0
    np.testing.assert_allclose(counts.ravel()[1:] * UNIT_M, truth.depth_m.ravel()[1:], atol=UNIT_M / 2 + 1e-6)


def test_truth_beyond_16_bits_is_unknown_in_the_png_but_kept(tmp_path: Path) -> None:
    depth_m = np.full((5, 7), 0.25, np.float32)
    depth_m[1, 2] = 65535 * UNIT_M
    depth_m[3, 4] = 20.0
    frame = make_frame(0, truth=GroundTruth(np.ones((5, 7), bool), depth_m))
    export_folder(ListSource([frame]), tmp_path / "out")
    counts = cv2.imread(str(tmp_path / "out/000000/truth_depth.png"), cv2.IMREAD_UNCHANGED)
    assert np.argwhere(counts != 1000).tolist() == [[1, 2], [3, 4]]
    assert counts[1, 2] == counts[3, 4] == 0
    assert_same(frame, FolderSource(tmp_path / "out").read(0))


def test_truth_in_a_png_is_in_counts_with_0_and_65535_unknown(recording: Path) -> None:
    folder = recording / "000000"
    (folder / "truth_depth.npy").unlink()
    counts = np.full((5, 7), 1000, np.uint16)
    counts[0, :2] = 0, 65535
    cv2.imwrite(str(folder / "truth_depth.png"), counts)
    truth = FolderSource(recording).read(0).truth
    assert truth is not None
    assert truth.depth_m is not None
    assert np.isnan(truth.depth_m[0, :2]).all()
    assert (truth.depth_m[1:] == np.float32(0.25)).all()


def test_a_rig_file_keeps_every_bit(tmp_path: Path) -> None:
    plain = Rig(proximity=RIG.proximity, tactile=RIG.proximity)
    for rig in (RIG, plain):
        save_rig(rig, tmp_path / "rig.json")
        assert load_rig(tmp_path / "rig.json") == rig


# --- export ----------------------------------------------------------------------------------------


def test_export_starts_at_the_position_and_stops_after_so_many_frames(tmp_path: Path) -> None:
    source = ListSource([make_frame(seed) for seed in range(5)])
    source.seek(1)
    told: list[float] = []
    assert export_folder(source, tmp_path / "out", frames=3, progress=lambda share, _: told.append(share)) == 3
    assert [frame.sequence for frame in FolderSource(tmp_path / "out")] == [101, 102, 103]
    assert told == pytest.approx([1 / 3, 2 / 3, 1.0])
    assert export_folder(source, tmp_path / "rest", frames=9, progress=lambda share, _: told.append(share)) == 1
    assert told[-1] == 1.0


def test_a_live_source_is_exported_for_so_many_frames(tmp_path: Path) -> None:
    assert export_folder(LiveSource(), tmp_path / "out", frames=2) == 2
    with pytest.raises(ExportError, match=r"live is live.*how many frames"):
        export_folder(LiveSource(), tmp_path / "other")


def test_the_folder_has_its_name_only_when_it_is_complete(tmp_path: Path) -> None:
    target = tmp_path / "deep" / "out"
    seen: list[bool] = []
    export_folder(ListSource([make_frame(0)]), target, progress=lambda *_: seen.append(target.exists()))
    assert seen == [False]
    assert (target / "rig.json").exists()
    assert os.listdir(target.parent) == ["out"]  # noqa: PTH208


@pytest.mark.parametrize("error", [SourceError("the camera is gone"), KeyboardInterrupt(), OSError(28, "disk full")])
def test_a_broken_export_leaves_nothing(tmp_path: Path, error: BaseException) -> None:
    class Breaking(ListSource):
        def read(self, index: int) -> SensorFrame:
            if index == 1:
                raise error
            return super().read(index)

    expected = ExportError if isinstance(error, OSError) else type(error)
    with pytest.raises(expected):
        export_folder(Breaking([make_frame(0), make_frame(1)]), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


def test_an_export_overwrites_nothing(tmp_path: Path) -> None:
    target = tmp_path / "out"
    target.mkdir()
    (target / "notes.txt").write_text("mine")
    with pytest.raises(ExportError, match=r"out is already there and not an empty folder; choose another name"):
        export_folder(ListSource([make_frame(0)]), target)
    assert [path.name for path in target.iterdir()] == ["notes.txt"]
    (target / "notes.txt").unlink()
    export_folder(ListSource([make_frame(0)]), target)
    assert FolderSource(target).length == 1
    with pytest.raises(ExportError, match="already there"):
        export_folder(ListSource([make_frame(0)]), "/")
    file = tmp_path / "file"
    file.write_text("mine")
    with pytest.raises(ExportError, match="already there"):
        export_folder(ListSource([make_frame(0)]), file)
    assert file.read_text() == "mine"


def test_the_working_folder_is_not_pulled_away(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ExportError, match="the working folder; name a new folder"):
        export_folder(ListSource([make_frame(0)]), ".")
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_be_exported_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="0 frames"):
        export_folder(ListSource([make_frame(0)]), tmp_path / "out", frames=0)
    with pytest.raises(ExportError, match="no frames left"):
        export_folder(ListSource([]), tmp_path / "out")
    small = Rig(proximity=RIG.tactile, tactile=RIG.tactile)
    with pytest.raises(FrameError, match="7 x 5 pixels, the rig says 6 x 4"):
        export_folder(ListSource([make_frame(0)], rig=small), tmp_path / "out")
    for change in ({"tactile_color": np.zeros((5, 6, 3), np.uint8)}, {"truth": GroundTruth(np.zeros((4, 7), bool))}):
        with pytest.raises(FrameError, match="leave it out"):
            export_folder(ListSource([make_frame(0, **change)]), tmp_path / "out")
    assert list(tmp_path.iterdir()) == []


# --- reading ---------------------------------------------------------------------------------------


def test_one_frame_may_lie_beside_rig_json(recording: Path) -> None:
    single = recording / "000001"
    (recording / "rig.json").rename(single / "rig.json")
    (single / "frame.json").unlink()
    source = FolderSource(single)
    assert source.length == 1
    assert source.frame_rate_hz == 30.0
    assert source.reference() is None
    assert_same(source.read(0), make_frame(1, sequence=0, proximity_time_s=0.0, tactile_time_s=0.0))


def test_numbered_frames_come_in_numeric_order_with_gaps(recording: Path) -> None:
    (recording / "000000").rename(recording / "10")
    (recording / "000001").rename(recording / "9")
    (recording / "notes").mkdir()
    (recording / "10" / "frame.json").unlink()
    source = FolderSource(recording)
    assert [frame.sequence for frame in source] == [101, 1]
    assert source.read(1).proximity_time_s == source.read(1).tactile_time_s == pytest.approx(1 / 30)
    source.seek(1)
    last = source.next_frame()
    assert last is not None
    assert last.sequence == 1
    assert source.next_frame() is None


def test_the_frame_rate_is_that_of_the_time_stamps(tmp_path: Path) -> None:
    times = [5.0, 5.1, 5.2, 6.2]
    export_folder(
        ListSource([make_frame(0, sequence=i, proximity_time_s=time) for i, time in enumerate(times)]), tmp_path / "out"
    )
    assert FolderSource(tmp_path / "out").frame_rate_hz == pytest.approx(10.0)


def test_colours_are_rgb(recording: Path) -> None:
    blue_green_red = np.zeros((8, 9, 3), np.uint8)
    blue_green_red[..., 0], blue_green_red[..., 2] = 10, 200
    cv2.imwrite(str(recording / "000000/proximity_color.png"), blue_green_red)
    cv2.imwrite(str(recording / "000000/tactile_color.png"), blue_green_red[:4, :6])
    frame = FolderSource(recording).read(0)
    assert frame.proximity_color[0, 0].tolist() == [200, 0, 10]
    assert frame.tactile_color is not None
    assert frame.tactile_color[0, 0].tolist() == [200, 0, 10]


def write(path: Path, *shape: int, dtype: type = np.uint16, value: int = 0) -> None:
    cv2.imwrite(str(path), np.full(shape, value, dtype))


def edit(path: Path, **changes: object) -> None:
    data = json.loads(path.read_text())
    for key, value in changes.items():
        if value is None:
            del data[key]
        else:
            data[key] = value
    path.write_text(json.dumps(data))


def absurd_png() -> bytes:
    """A PNG that claims 100,000 x 100,000 pixels."""
    header = b"IHDR" + struct.pack(">IIBBBBB", 100_000, 100_000, 16, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))


def claim_shape(path: Path, shape: tuple[int, ...]) -> None:
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f4", "fortran_order": False, "shape": shape})


F = "000000"
BAD = {
    "no rig": (lambda p: (p / "rig.json").unlink(), r"there is no file .*rig\.json"),
    "rig is no JSON": (lambda p: (p / "rig.json").write_text("{\n oops"), r"rig\.json is no JSON: line 2"),
    "rig is binary": (lambda p: (p / "rig.json").write_bytes(b"\xff\xfe"), r"rig\.json is no JSON text"),
    "rig is a list": (lambda p: (p / "rig.json").write_text("[]"), r"rig\.json holds a list"),
    "rig lacks a camera": (lambda p: edit(p / "rig.json", tactile=None), r"rig\.json: tactile is missing"),
    "rig has a stray field": (lambda p: edit(p / "rig.json", tactil={}), r"rig\.json: tactil is no field"),
    "pose is no rotation": (
        lambda p: edit(p / "rig.json", T_proximity_tactile=np.diag([2, 1, 1, 1]).tolist()),
        r"rig\.json: T_proximity_tactile: .*no rotation",
    ),
    "no frames": (
        lambda p: [(p / F).rename(p / "a"), (p / "000001").rename(p / "b")],
        r"recording has no frames.*000000",
    ),
    "both forms": (
        lambda p: write(p / "proximity_depth.png", 5, 7),
        r"has images and numbered subfolders \(\d+\); keep one",
    ),
    "one number twice": (lambda p: (p / "000001").rename(p / "0"), r"are the same number; rename"),
    "missing image": (lambda p: (p / "000001/tactile_depth.png").unlink(), r"no file .*000001/tactile_depth\.png"),
    "wrong bit depth": (
        lambda p: write(p / F / "tactile_depth.png", 4, 6, dtype=np.uint8),
        r"tactile_depth\.png has 1 channels of 8 bits, but 1 of 16 bits",
    ),
    "colour in depth": (
        lambda p: write(p / F / "proximity_depth.png", 5, 7, 3),
        r"proximity_depth\.png has 3 channels of 16 bits",
    ),
    "grey colour": (
        lambda p: write(p / F / "proximity_color.png", 8, 9, dtype=np.uint8),
        r"proximity_color\.png has 1 channels of 8 bits, but 3 of 8",
    ),
    "wrong size": (
        lambda p: write(p / F / "proximity_depth.png", 5, 8),
        r"proximity_depth\.png is 8 x 5 pixels, but rig\.json says 7 x 5",
    ),
    "colour has depth's size": (
        lambda p: write(p / F / "proximity_color.png", 5, 7, 3, dtype=np.uint8),
        r"proximity_color\.png is 7 x 5 pixels, but rig\.json says 9 x 8",
    ),
    "wrong tactile colour": (
        lambda p: write(p / F / "tactile_color.png", 5, 7, 3, dtype=np.uint8),
        r"tactile_color\.png is 7 x 5 .* 6 x 4",
    ),
    "no PNG": (lambda p: (p / F / "tactile_depth.png").write_bytes(b"oops"), r"tactile_depth\.png is no readable PNG"),
    "truncated PNG": (
        lambda p: (p / F / "proximity_depth.png").write_bytes((p / F / "proximity_depth.png").read_bytes()[:-20]),
        r"proximity_depth\.png is no readable PNG",
    ),
    "truth with greys": (
        lambda p: write(p / F / "truth_contact.png", 5, 7, dtype=np.uint8, value=7),
        r"truth_contact\.png contains the value 7; only 0 and 255",
    ),
    "truth of other size": (
        lambda p: write(p / F / "truth_contact.png", 4, 6, dtype=np.uint8),
        r"truth_contact\.png is 6 x 4",
    ),
    "truth depth alone": (lambda p: (p / F / "truth_contact.png").unlink(), r"truth_depth\.png has no truth_contact"),
    "truth in float64": (
        lambda p: np.save(p / F / "truth_depth.npy", np.zeros((5, 7))),
        r"truth_depth\.npy holds float64",
    ),
    "truth is no array": (lambda p: (p / F / "truth_depth.npy").write_bytes(b""), r"truth_depth\.npy is no readable"),
    "frame.json lacks a field": (
        lambda p: edit(p / F / "frame.json", sequence=None),
        r"000000/frame\.json: sequence is missing",
    ),
    "frame.json has a stray field": (
        lambda p: edit(p / F / "frame.json", time=1),
        r"frame\.json: time is no field of a frame",
    ),
    "frame.json has a text": (
        lambda p: edit(p / F / "frame.json", tactile_time_s="1"),
        r"frame\.json: tactile_time_s is '1', but it should be a number of seconds",
    ),
    "sequence is a bool": (lambda p: edit(p / F / "frame.json", sequence=True), r"sequence is True"),
    "sequence is negative": (lambda p: edit(p / F / "frame.json", sequence=-1), r"sequence is -1.*whole number"),
    "time is huge": (lambda p: edit(p / F / "frame.json", tactile_time_s=10**400), "tactile_time_s is 1000"),
    "number of 5000 digits": (
        lambda p: (p / F / "frame.json").write_text(f'{{"sequence": {"1" * 5000}}}'),
        r"frame\.json contains a number of too many digits",
    ),
    "one sequence twice": (
        lambda p: edit(p / "000001/frame.json", sequence=json.loads((p / F / "frame.json").read_text())["sequence"]),
        r"000001/frame\.json has the sequence \d+, and so has 000000; correct it",
    ),
    "empty PNG": (lambda p: (p / F / "tactile_depth.png").write_bytes(b""), r"tactile_depth\.png is no readable PNG"),
    "PNG of absurd size": (
        lambda p: (p / F / "tactile_depth.png").write_bytes(absurd_png()),
        r"tactile_depth\.png is no readable PNG",
    ),
    "truth of absurd size": (
        lambda p: claim_shape(p / F / "truth_depth.npy", (10**9, 10**9)),
        r"truth_depth\.npy is no readable",
    ),
    "pose is an object": (
        lambda p: edit(p / "rig.json", T_proximity_tactile={}),
        r"rig\.json: T_proximity_tactile: a pose is a 4 x 4 matrix",
    ),
    "pose in millimetres": (
        lambda p: edit(p / "rig.json", T_proximity_tactile=[[1, 0, 0, 40], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]),
        r"rig\.json: T_proximity_tactile: .*metres up to 10",
    ),
    "time is nan": (lambda p: edit(p / F / "frame.json", proximity_time_s=float("nan")), r"proximity_time_s is nan"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_recording_is_refused_in_one_sentence_when_it_is_opened(recording: Path, case: str) -> None:
    FolderSource(recording)
    spoil, sentence = BAD[case]
    spoil(recording)
    with pytest.raises(SourceError, match=sentence) as caught:
        FolderSource(recording)
    assert "\n" not in str(caught.value)


def test_a_folder_whose_name_is_no_unicode_is_read(recording: Path) -> None:
    odd = recording.rename(recording.with_name(os.fsdecode(b"scene\xff")))
    assert FolderSource(odd).length == len(list(odd.glob("00*")))


def test_a_later_bad_frame_is_told_when_it_is_read(recording: Path) -> None:
    (recording / "000001/proximity_color.png").write_bytes(b"oops")
    source = FolderSource(recording)
    assert source.next_frame() is not None
    with pytest.raises(SourceError, match=r"000001/proximity_color\.png"):
        source.next_frame()


def test_a_reference_needs_its_images(recording: Path) -> None:
    (recording / "reference/tactile_depth.png").unlink()
    with pytest.raises(SourceError, match=r"reference/tactile_depth\.png"):
        FolderSource(recording).reference()


@pytest.mark.parametrize("name", ["missing", "file"])
def test_a_path_that_is_no_folder_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(SourceError, match=f"there is no folder .*{name}"):
        FolderSource(tmp_path / name)


# --- rig files -------------------------------------------------------------------------------------

BAD_CAMERA = {
    "fx": ("wide", "proximity.fx is 'wide', but it should be a valid number"),
    "model": (515, "proximity.model is 515, but it should be a valid string"),
    "height": ("480", "proximity.height is '480', but it should be a valid integer"),
    "width": (6.5, "proximity.width is 6.5, but it should be a valid integer"),
    "fy": (-1.0, "proximity.fy is -1.0, but it should be greater than or equal to 0.1"),
    "depth_unit_m": (0, "proximity.depth_unit_m is 0, but it should be greater than or equal to 0.0000001"),
    "distortion": ("ftheta", "proximity.distortion is 'ftheta', but it should be 'none', 'brown_conrady'"),
    "coefficients": ([0.1], r"proximity.coefficients.1 is missing \(and 3 more\)"),
    "cx": (None, "proximity.cx is missing; add it"),
    "lens": ("fish eye", "proximity.lens is no field of a rig"),
}


@pytest.mark.parametrize("field", BAD_CAMERA)
def test_a_bad_camera_field_is_named_with_its_value(recording: Path, field: str) -> None:
    value, sentence = BAD_CAMERA[field]
    path = recording / "rig.json"
    camera = json.loads(path.read_text())["proximity"]
    camera[field] = value
    if value is None:
        del camera[field]
    edit(path, proximity=camera)
    with pytest.raises(SourceError, match=rf"rig\.json: {sentence}"):
        load_rig(path)


# --- real data -------------------------------------------------------------------------------------


@pytest.mark.skipif(not (DATA / "real_pair").is_dir(), reason=f"no recording real_pair in {DATA}")
def test_the_real_pair_is_read_as_it_is(tmp_path: Path) -> None:
    folder = DATA / "real_pair"
    source = FolderSource(folder)
    frame = source.read(0)
    rig = json.loads((folder / "rig.json").read_text())
    assert source.rig.proximity.intrinsics.fx == rig["proximity"]["fx"]
    assert source.rig.tactile.depth_unit_m == rig["tactile"]["depth_unit_m"]
    np.testing.assert_array_equal(source.rig.T_proximity_tactile, rig["T_proximity_tactile"])
    for name in ("proximity_depth", "tactile_depth"):
        np.testing.assert_array_equal(getattr(frame, name), cv2.imread(str(folder / f"{name}.png"), -1))
    for name in ("proximity_color", "tactile_color"):
        np.testing.assert_array_equal(getattr(frame, name), cv2.imread(str(folder / f"{name}.png"))[:, :, ::-1])
    export_folder(source, tmp_path / "copy")
    copy = FolderSource(tmp_path / "copy")
    assert copy.rig == source.rig
    assert_same(frame, copy.read(0))
