"""Thousands of damaged files, seeds fixed: each is read or refused in a sentence, in little memory and time."""

from __future__ import annotations

import json
import os
import random
import re
import signal
import subprocess
import sys
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PyQt6.QtWidgets import QWidget

from attacks import bounded
from folder_scenes import RIG, ListSource, make_frame
from fuzz_recordings import damaged
from tactune.app.document.keeping import write_json
from tactune.app.document.recovery import unsaved_work
from tactune.app.settings import Settings
from tactune.app.sources.thumbnails import Thumbnails
from tactune.core import ContactPipeline, load_preset, open_source
from tactune.core.calibration.correspondences import read_points as read_pairs
from tactune.core.errors import TactuneError
from tactune.core.estimation.object_mesh import load_mesh
from tactune.core.evaluation.scan.pose import load_transform
from tactune.core.evaluation.scan.pose import read_pairs as read_scan_pairs
from tactune.core.evaluation.scan.scan import load_scan
from tactune.core.model.clouds import PointCloud
from tactune.core.model.rig_file import load_rig, rig_to_json
from tactune.core.output.cloud_files import read_cloud, read_points, write_cloud
from tactune.core.output.markers import load_marks
from tactune.core.output.writer import export_mcap
from tactune.core.preset import Preset
from tactune.core.preset.file import preset_json, save_preset
from tactune.core.sources.folder import export_folder
from tactune.core.tuning.advice.example_file import load_example, save_example
from tactune.core.tuning.advice.proposal import Example

pytestmark = pytest.mark.long

#: Values that are put in place of a value of a JSON, CSV or text file.
VALUES = (
    *("null", "[]", "{}", '""', '"x"', "true", "-1", "0", "1e300", "-1e300", "NaN", "Infinity", "1" * 400, "0.5"),
    *("[[[[]]]]", "9223372036854775808", '"\\u0000"', '"../../x"', "[1e999]"),
)
POSE = '{"T_proximity_scan": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.3], [0, 0, 0, 1]]}'
PAIRS = "id,enabled,proximity_u,proximity_v,tactile_u,tactile_v,tactile_depth_m\n" + "a,1,2,3,4,5,0.3\nb,0,2,3,4,5,\n"
SCAN_PAIRS = "scan_x,scan_y,scan_z,patch_x_m,patch_y_m,patch_z_m\n1,2,3,0.1,0.2,0.3\n4,5,6,0.1,0.3,0.2\n"
MARKS = '{"markers": [{"frame": 3, "name": "here", "time_s": 0.1}], "trim": [1, 5]}'
OBJ = "v 0 0 0 1 0 0\nv .1 0 0 0 1 0\nv 0 .1 0 0 0 1\nv 0 0 .1 1 1 1\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 1 3 4\n"
CLOUD = PointCloud(np.linspace(0, 0.3, 60, dtype=np.float32).reshape(20, 3))


def play(path: Path) -> None:
    with open_source(str(path)) as source:
        pipeline = ContactPipeline(Preset(contact_test="tolerance"), source.rig)
        for frame in source:
            pipeline.process(frame)


def text(content: str) -> Callable[[Path], object]:
    return lambda path: path.write_text(content)


def cloud(path: Path) -> None:
    write_cloud(path, CLOUD)


KINDS: dict[str, tuple[Callable[[Path], object], Callable[[Path], Any], int]] = {
    "preset.json": (text(preset_json(Preset())), load_preset, 600),
    "rig.json": (text(json.dumps(rig_to_json(RIG))), load_rig, 600),
    "a.markers.json": (text(MARKS), load_marks, 300),
    "pose.json": (text(POSE), load_transform, 400),
    "pairs.csv": (text(PAIRS), read_pairs, 400),
    "scan.csv": (text(SCAN_PAIRS), read_scan_pairs, 400),
    "a.npz": (cloud, read_cloud, 400),
    "a.ply": (cloud, read_points, 400),
    "a.pcd": (cloud, read_points, 400),
    "a.csv": (cloud, read_points, 400),
    "example.npz": (lambda p: save_example(Example(make_frame(1), None, None), p), load_example, 300),
    "scan.obj": (text(OBJ), load_scan, 200),
    "mesh.obj": (text(OBJ), load_mesh, 100),
    "a.mcap": (lambda p: export_mcap(ListSource([make_frame(n) for n in range(3)]), p), play, 400),
}


def mutated(whole: bytes, rng: random.Random) -> bytes:
    """Return a file with random bytes changed, or where it is text, with one or two values replaced."""
    if whole.isascii() and rng.random() < 0.7:
        content = whole.decode()
        for _ in range(rng.choice([1, 1, 2])):
            places = list(re.finditer(r'"[^"\n]*"|-?[0-9.][0-9.e+-]*|true|false|null', content))
            place = rng.choice(places)
            content = content[: place.start()] + rng.choice(VALUES) + content[place.end() :]
        return content.encode()
    return damaged(whole, rng)


def read_or_refused(read: Callable[[Path], Any], path: Path, what: str) -> bool:
    try:
        read(path)
    except TactuneError as error:
        assert "\n" not in str(error), what
        return False
    except Exception as error:
        raise AssertionError(f"{what}: {type(error).__name__}: {error}") from error
    return True


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", KINDS)
def test_damaged_files_are_read_or_refused(name: str, tmp_path: Path) -> None:
    make, read, count = KINDS[name]
    path = tmp_path / name
    make(path)
    assert read_or_refused(read, path, "undamaged")
    whole = path.read_bytes()
    refused = 0
    for seed in range(count):
        path.write_bytes(mutated(whole, random.Random(f"{name} {seed}")))
        with bounded(len(whole)):
            refused += not read_or_refused(read, path, f"{name}, seed {seed}")
    assert refused > count // 10
    assert [file.name for file in tmp_path.iterdir()] == [name], "something was written"


@pytest.mark.filterwarnings("ignore")
def test_damaged_folders_are_read_or_refused(tmp_path: Path) -> None:
    whole = tmp_path / "a"
    export_folder(ListSource([make_frame(n) for n in range(2)]), whole)
    files = sorted(file for file in whole.rglob("*") if file.is_file())
    for seed in range(300):
        rng = random.Random(f"folder {seed}")
        file = rng.choice(files)
        data = file.read_bytes()
        file.write_bytes(mutated(data, rng))
        with bounded(len(data)):
            read_or_refused(play, whole, f"{file.name}, seed {seed}")
        file.write_bytes(data)


def test_damaged_states_of_the_window_keep_it_from_nothing(tmp_path: Path, qapp: object) -> None:
    unsaved, settings = tmp_path / "unsaved-1.json", tmp_path / "window.json"
    write_json(unsaved, {"path": None, "preset": json.loads(preset_json(Preset()))})
    settings.write_text(json.dumps({"window/geometry": "AdnQywADAAA=", "view/point_size": "2.0", "theme": "dark"}))
    wholes = {file: file.read_bytes() for file in (unsaved, settings)}
    found = 0
    for seed in range(400):
        for file, whole in wholes.items():
            file.write_bytes(mutated(whole, random.Random(f"{file.name} {seed}")))
        found += len(unsaved_work(tmp_path))
        read = Settings(settings)
        assert isinstance(read.number("view/point_size", 1.0), float)
        assert isinstance(read.text("theme"), str)
        QWidget().restoreGeometry(read.blob("window/geometry"))
    assert 0 < found < 400


def test_a_picture_that_is_damaged_or_a_pipe_is_left_out(tmp_path: Path) -> None:
    pictures = Thumbnails(tmp_path)
    pictures.keep("a", np.full((90, 160, 3), (200, 10, 30), np.uint8))
    file, shown = pictures.path("a"), pictures.load("a")
    assert shown is not None
    assert shown[0, 0].tolist() == [200, 10, 30]
    whole = file.read_bytes()
    for seed in range(300):
        file.write_bytes(damaged(whole, random.Random(f"picture {seed}")))
        with bounded(len(whole)):
            pictures.load("a")
    file.unlink()
    os.mkfifo(file)
    with bounded(0):
        assert pictures.load("a") is None


def test_an_encrypted_archive_is_refused(tmp_path: Path) -> None:
    cloud(tmp_path / "a.npz")
    data = bytearray((tmp_path / "a.npz").read_bytes())
    with zipfile.ZipFile(tmp_path / "a.npz") as archive:
        first = archive.infolist()[0].header_offset
    data[first + 6] |= 1
    data[data.index(b"PK\x01\x02") + 8] |= 1
    (tmp_path / "a.npz").write_bytes(data)
    with pytest.raises(TactuneError, match="encrypted"):
        read_cloud(tmp_path / "a.npz")


SAVER = """
import sys
from tactune.core.preset import Preset
from tactune.core.preset.file import save_preset
print("ready", flush=True)
while True:
    save_preset(Preset(name=sys.argv[2] * 60), sys.argv[1])
"""


def test_two_savers_that_are_killed_leave_a_whole_preset(tmp_path: Path) -> None:
    path = tmp_path / "shared.json"
    save_preset(Preset(name="c" * 60), path)
    rng = random.Random(1)
    for _ in range(4):
        savers = [
            subprocess.Popen([sys.executable, "-c", SAVER, path, letter], stdout=subprocess.PIPE) for letter in "ab"
        ]
        for saver in savers:
            assert saver.stdout is not None
            saver.stdout.readline()
        end = time.monotonic() + rng.uniform(0.1, 0.6)
        while time.monotonic() < end:
            assert load_preset(path).name in {letter * 60 for letter in "abc"}
        for saver in savers:
            saver.send_signal(signal.SIGKILL)
            saver.communicate()
        assert load_preset(path).name in {letter * 60 for letter in "abc"}
    assert [file.name for file in tmp_path.iterdir() if not file.name.startswith(".")] == ["shared.json"]
