"""Every kind of file that the product writes or reads: one table for damage, kills, full disks and two writers."""

from __future__ import annotations

import itertools
import os
import resource
import shutil
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar
from xml.etree import ElementTree

import cv2
import h5py
import numpy as np
from PyQt6.QtCore import QCoreApplication, Qt
from PyQt6.QtWidgets import QApplication, QWidget

from bag_maker import D405, L515, make_bag
from folder_scenes import RIG, list_source, make_frame
from tactune.app.calibration.keeping import Keeper
from tactune.app.calibration.session import Session, SessionState, Snapshot
from tactune.app.document.document import Document
from tactune.app.document.recovery import Autosave, KeptState, unsaved_work
from tactune.app.settings import Settings
from tactune.core import ContactPipeline, open_source
from tactune.core.calibration.points import read_points as read_pairs
from tactune.core.calibration.points import write_points
from tactune.core.calibration.snapshots import content_hash
from tactune.core.errors import ExportError, SourceError, TactuneError
from tactune.core.estimation.object_mesh import load_mesh
from tactune.core.estimation.pose import open_poses
from tactune.core.lab import table
from tactune.core.lab.scan import load_scan, load_transform
from tactune.core.model.alignment import PointPair
from tactune.core.model.files import write_csv
from tactune.core.model.frames import TrueStrain
from tactune.core.model.patch import AlignedDepth, ContactPatch
from tactune.core.model.rig_file import load_rig
from tactune.core.output.calibration_files import export_calibration
from tactune.core.output.cloud_files import write_cloud
from tactune.core.output.foxglove import save_layout
from tactune.core.output.hdf5 import export_hdf5
from tactune.core.output.writer import PatchWriter, SessionWriter, export_mcap
from tactune.core.preset import Preset
from tactune.core.preset.file import save_preset
from tactune.core.rig.untouched import load_untouched, save_untouched
from tactune.core.sources.folder import export_folder, write_rig
from tactune.core.sources.lens_files import read_lenses
from tactune.core.sources.presets import load_preset
from tactune.core.sources.simulator.scene import CleanState, PressFacts, simulator_rig
from tactune.core.sources.simulator.simulator_source import SolvedScene, load_scene, save_scene
from tactune.core.tuning.measure import Measured, Workers
from tactune.core.tuning.plan import Axis, Clip, Plan
from tactune.core.tuning.study import Study

Kept = TypeVar("Kept", bound=KeptState[Any])
DATA = Path(__file__).parent.parent / "data"
POSE = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.3), (0.0, 0.0, 0.0, 1.0))
PRESET = Preset(contact_test="tolerance").with_value("alignment.rigid.T_proximity_tactile", POSE)
FRAMES = [make_frame(n) for n in range(3)]
CLOUDS = [np.full((2000 + n, 3), 0.3 + n, np.float32) for n in range(2)]
_numbers = itertools.count()


@dataclass(frozen=True)
class Kind:
    """A kind of file.

    Attributes
    ----------
    write : callable
        Write version 0 or 1 into a folder, by the product where ``ours``.
    read : callable or None
        Read what is in the folder; False, or a `TactuneError`, where it is refused. None: the product does not read it.
    damaged : int
        Number of damaged files to try; 0 if only tests read it.
    ours : bool
        Whether the product writes it.
    grows : bool
        Whether a write that fails leaves the part that was written, by intention.
    silent : bool
        Whether a write that fails says nothing: what is lost are only values to begin with.
    keeps_state : bool
        Whether reading writes, too: a search goes on, a damaged state of the window is set aside.
    new : callable or None
        Write version 0 or 1 under the one name ``new``, refused where it is taken; None: the product never refuses.
    """

    write: Callable[[Path, int], object]
    read: Callable[[Path], object] | None = None
    damaged: int = 300
    ours: bool = True
    grows: bool = False
    silent: bool = False
    keeps_state: bool = False
    new: Callable[[Path, int], object] | None = None


def fresh(folder: Path, suffix: str = "") -> Path:
    """Return a name that no other process uses."""
    return folder / f"{os.getpid()}-{next(_numbers)}{suffix}"


def play(path: Path) -> None:
    with open_source(str(path)) as source:
        pipeline = ContactPipeline(PRESET, source.rig) if source.rig.has_proximity else None
        for frame in source:
            if pipeline is not None:
                pipeline.process(frame)


def play_all(folder: Path) -> None:
    """Play all recordings; one that was killed before its first frame may say so."""
    for path in folder.glob("[!.]*"):
        try:
            play(path)
        except SourceError as error:
            if "cut off before its first frame" not in str(error):
                raise


def record(path: Path, n: int) -> None:
    with SessionWriter(path, RIG, untouched=FRAMES[0]) as writer:
        for frame in FRAMES[n:]:
            writer.put(frame, wait=True)
        if error := writer.close().error:
            raise ExportError(error)


def write_patches(path: Path, n: int) -> None:
    shape = RIG.proximity.intrinsics.shape
    nothing = np.zeros(shape, np.uint8), AlignedDepth.empty(shape)
    with PatchWriter(path, RIG, Preset(), 30.0) as writer:
        for number in range(3):
            writer.write(ContactPatch(number, CLOUDS[n], *nothing, RIG, {}), number / 30)


def write_untouched(folder: Path, n: int) -> None:
    record = save_untouched(FRAMES[n], 1, folder / "a.json")
    save_preset(Preset(name="n" * 60, untouched=record), folder / "a.json")


def read_untouched(folder: Path) -> None:
    preset = load_preset(folder / "a.json")
    if preset.untouched is not None:
        load_untouched(preset.untouched, folder / "a.json")


def read_rigs(folder: Path) -> None:
    for path in folder.glob("[0-9]*/rig.json"):
        load_rig(path)


def solved_scene(folder: Path, n: int) -> None:
    rig = simulator_rig()
    shapes = (rig.proximity.intrinsics.shape, rig.tactile.intrinsics.shape)
    deep, flat = (np.full(shapes[0], n, kind) for kind in (np.uint16, np.uint8))
    colours = [np.full((*shape, 3), n, np.uint8) for shape in shapes]
    state = CleanState(deep, deep, flat, flat, colours[0], np.full(shapes[1], n, np.uint16), colours[1], deep)
    facts = PressFacts(0.01, TrueStrain(0.1, 0.1, 0.1, 0.1), 1e-6, POSE, (0.0, 0.0, -1.0), 2000.0)
    save_scene(folder / "cup.npz", SolvedScene([state], [facts]))


# The search


class _NoWork:
    """Workers that measure nothing."""

    def submit(self, work: object, plan: Plan, trials: list[dict[str, Any]]) -> Future[list[Measured]]:
        future: Future[list[Measured]] = Future()
        future.set_result([({"iou": 0.5, "points": 9.0}, "") for _ in trials])
        return future


CLIP = Clip("folder:rec", range(3), True)
PLANS = [
    Plan(Preset(), (Axis("tolerance.t", (0.004, 0.012, 0.02 + n / 100)),), (CLIP,), ("iou",), True, 3) for n in range(2)
]


def search(folder: Path, n: int) -> bool:
    study = Study(PLANS[n], folder / "s.log")
    list(study.run(Workers(_NoWork(), 1)))  # type: ignore[arg-type]
    trials, _ = study.results()
    values = {str(trial.values["tolerance.t"]) for trial in trials}
    return len(trials) == 3 and values == set(map(str, PLANS[n].axes[0].values))


# What the window keeps


@cache
def application() -> QCoreApplication:
    return QCoreApplication.instance() or QApplication([])


@contextmanager
def said_as_errors(keeper: Kept) -> Iterator[Kept]:
    said: list[str] = []
    keeper.failed.connect(said.append, Qt.ConnectionType.DirectConnection)
    yield keeper
    if said:
        raise ExportError(said[0])


SNAPSHOTS = [Snapshot(content_hash(frame), "here", frame) for frame in FRAMES[:2]]
PAIR = PointPair(id="1", proximity_u=1.0, proximity_v=2.0, tactile_u=4.0, tactile_v=5.0, tactile_depth_m=0.3)


def calibrate(folder: Path, n: int) -> None:
    application()
    session = Session(RIG)
    with said_as_errors(Keeper(session, folder)) as keeper:
        session.edit("all", SessionState((SNAPSHOTS[n],), (PAIR,) * 9))
        keeper.close()


def restore_calibration(folder: Path) -> bool:
    application()
    session, said = Session(RIG), list[str]()
    keeper = Keeper(session, folder)
    keeper.failed.connect(said.append)
    keeper.restore()
    keeper.close()
    return not said


def autosave(folder: Path, n: int) -> None:
    application()
    document = Document(Preset())
    with said_as_errors(Autosave(document, folder)) as keeper:
        document.edit("name", "ab"[n] * 60)
        keeper.flush()
        keeper.close(keep=True)


def remember(folder: Path, n: int) -> None:
    application()
    settings = Settings(folder / "window.json")
    settings.set("view/point_size", 2 + n)
    settings.set("theme", "dark")
    settings.set("window/geometry", QWidget().saveGeometry())
    settings.sync()


def read_settings(folder: Path) -> bool:
    application()
    settings = Settings(folder / "window.json")
    settings.text("view/point_size")
    settings.recent("source")
    QWidget().restoreGeometry(settings.blob("window/geometry"))
    return settings.text("theme") == "dark"


# Files of other programs

OBJ = "v 0 0 0 1 0 0\nv .1 0 0 0 1 0\nv 0 .1 0 0 0 1\nv 0 0 .1 1 1 1\nf 1 2 3\nf 1 2 4\nf 2 3 4\nf 1 3 4\n"
TEXTURED = "mtllib a.mtl\nv 0 0 0\nv .1 0 0\nv 0 .1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\n"


def textured(folder: Path, n: int) -> None:
    (folder / "a.obj").write_text(TEXTURED)
    (folder / "a.mtl").write_text("newmtl a\nKd 1 1 1\nmap_Kd a.png\n")
    cv2.imwrite(str(folder / "a.png"), np.full((16, 16, 3), (50, 90, 200), np.uint8))


def box(name: str) -> Callable[[Path, int], object]:
    import trimesh

    return lambda folder, n: trimesh.creation.box((0.1, 0.1, 0.1)).export(folder / name)


def write_poses(folder: Path, n: int) -> None:
    with open_poses(folder / "a.csv") as write:
        for _ in range(999):
            write({"sequence": n, "time_s": 0.1, "lost": 0})


def text(name: str, content: str) -> Callable[[Path, int], object]:
    return lambda folder, n: (folder / name).write_text(content)


def copied(name: str) -> Callable[[Path, int], object]:
    return lambda folder, n: shutil.copy(DATA / name, folder)


def cloud(name: str) -> Kind:
    def write(folder: Path, n: int) -> None:
        colors = dict.fromkeys(("red", "green", "blue"), np.zeros(len(CLOUDS[n]), np.uint8))
        write_cloud(folder / name, dict(zip("xyz", CLOUDS[n].T, strict=True)) | colors)

    return Kind(write)


def read_hdf5(folder: Path) -> None:
    with h5py.File(folder / "a.h5") as file:
        assert len(file["sequence"]) == len(file["tactile/depth"]) == len(FRAMES)


def read_urdf(folder: Path) -> None:
    assert ElementTree.parse(folder / "a.urdf").getroot().tag == "robot"


#: Depth in four forms, colour in two: numbered files of other programs.
FOREIGN = {
    f"{n}_{name}": image
    for n in (1, 2)
    for name, image in {
        "proximity_depth.tiff": np.linspace(0.2, 0.4, 35, dtype=np.float32).reshape(5, 7),
        "tactile_depth.pgm": FRAMES[0].tactile_depth,
        "proximity_rgb.bmp": FRAMES[0].proximity_color,
        "tactile_color.png": np.dstack([FRAMES[0].tactile_color, FRAMES[0].tactile_color[..., :1]]),
    }.items()
}


def foreign_folder(folder: Path, n: int) -> None:
    write_rig(folder, RIG)
    for name, image in FOREIGN.items():
        cv2.imwrite(str(folder / name), image)
    (folder / "associations.txt").write_text("1.5 1_proximity_depth.tiff 1.5 1_tactile_depth.pgm\n")


def npy_folder(folder: Path, n: int) -> None:
    write_rig(folder, RIG)
    np.save(folder / "proximity_depth.npy", FRAMES[0].proximity_depth)
    np.save(folder / "tactile_depth.npy", FRAMES[0].tactile_depth.astype(np.float32) * 1e-4)


def lens_file(name: str) -> Kind:
    """A lens as OpenCV writes it."""

    def write(folder: Path, n: int) -> None:
        file = cv2.FileStorage(str(folder / name), cv2.FILE_STORAGE_WRITE)
        file.write("camera_matrix", np.array([[30, 0, 15.5], [0, 31, 11.5], [0, 0, 1.0]]))
        file.write("distortion_coefficients", np.array([0.1, -0.05, 0.001, 0.002, 0.01]))
        file.release()

    return Kind(write, lambda folder: read_lenses(folder / name)[0].lens((32, 24)), ours=False)


def camchain(folder: Path, n: int) -> None:
    export_calibration(folder / "a.yaml", "kalibr", RIG.model_copy(update={"tactile": RIG.proximity}))


def read_camchain(folder: Path) -> None:
    for lens in read_lenses(folder / "a.yaml"):
        lens.lens(lens.size or (7, 5))


POINTS = [PAIR.model_copy(update={"id": str(k)}) for k in range(50)]
SCENE = table.Scene("usual", "standard", "cup", "low", "")
CELL = table.Cell("usual", "standard", "cup", "low", "", 0, "straight", rmse_mm=0.5)


def table_plan(folder: Path) -> table.Plan:
    return table.Plan((SCENE,), (0,), ("straight",), Preset(), folder)


KINDS: dict[str, Kind] = {
    "preset": Kind(
        lambda f, n: save_preset(Preset(name="ab"[n] * 60), f / "a.json"),
        lambda f: load_preset(f / "a.json"),
        600,
        new=lambda f, n: save_preset(Preset(name=f"number {n}"), f / "new.json", exclusive=True),
    ),
    "untouched frame": Kind(write_untouched, read_untouched),
    "rig": Kind(lambda f, n: write_rig(fresh(f), RIG), read_rigs, 600, new=lambda f, n: write_rig(f / "new", RIG)),
    "folder": Kind(
        lambda f, n: export_folder(list_source(FRAMES), fresh(f)),
        play_all,
        new=lambda f, n: export_folder(list_source(FRAMES[n:]), f / "new"),
    ),
    "foreign folder": Kind(foreign_folder, play, ours=False),
    "folder of arrays": Kind(npy_folder, play, ours=False),
    **{f"lens.{suffix}": lens_file(f"a.{suffix}") for suffix in ("yaml", "xml", "json")},
    "lens.txt": Kind(text("a.txt", "30 0 15\n0 31 11\n0 0 1\n"), lambda f: read_lenses(f / "a.txt"), 100, ours=False),
    "camchain": Kind(camchain, read_camchain, 100),
    "URDF": Kind(
        lambda f, n: export_calibration(f / "a.urdf", "urdf", RIG),
        read_urdf,
        0,
        new=lambda f, n: export_calibration(f / "new.urdf", "urdf", RIG, exclusive=True),
    ),
    "HDF5": Kind(
        lambda f, n: export_hdf5(list_source(FRAMES), f / "a.h5"),
        read_hdf5,
        0,
        new=lambda f, n: export_hdf5(list_source(FRAMES[n:]), f / "new.h5", exclusive=True),
    ),
    "recording": Kind(lambda f, n: record(fresh(f, ".mcap"), 0), play_all, 400, grows=True),
    "converted recording": Kind(
        lambda f, n: export_mcap(list_source(FRAMES[n:]), f / "a.mcap"),
        play_all,
        100,
        new=lambda f, n: export_mcap(list_source(FRAMES[n:]), f / "new.mcap", exclusive=True),
    ),
    "patches": Kind(lambda f, n: write_patches(fresh(f, ".mcap"), n), grows=True),
    "cloud.npz": cloud("a.npz"),
    "cloud.ply": cloud("a.ply"),
    "cloud.csv": cloud("a.csv"),
    "points": Kind(lambda f, n: write_points(f / "a.csv", POINTS[n:]), lambda f: read_pairs(f / "a.csv")),
    "transform": Kind(
        text("a.txt", "\n".join(" ".join(map(str, row)) for row in POSE)),
        lambda f: load_transform(f / "a.txt"),
        400,
        ours=False,
    ),
    "poses": Kind(write_poses),
    "layout": Kind(lambda f, n: save_layout(f / "a.json")),
    "table.csv": Kind(lambda f, n: write_csv(f / "a.csv", [{"a": n}] * 999)),
    "table cell": Kind(
        lambda f, n: table.save_cells(table_plan(f), SCENE, 0, [CELL]),
        lambda f: table.load_cells(table_plan(f), SCENE, 0) is not None,
    ),
    "simulator's cache": Kind(solved_scene, lambda f: load_scene(f / "cup.npz", 1) is not None, 200),
    "search": Kind(search, lambda f: search(f, 0), 600, grows=True, keeps_state=True),
    "unsaved preset": Kind(autosave, lambda f: len(unsaved_work(f)) == len(list(f.glob("unsaved-*.json")))),
    "calibration": Kind(calibrate, restore_calibration, keeps_state=True),
    "settings": Kind(remember, read_settings, silent=True),
    "scan": Kind(text("a.obj", OBJ), lambda f: load_scan(f / "a.obj"), 200, ours=False),
    "textured scan": Kind(textured, lambda f: load_scan(f / "a.obj"), ours=False),
    "mesh": Kind(text("a.obj", OBJ), lambda f: load_mesh(f / "a.obj"), 100, ours=False),
    "mesh.stl": Kind(box("a.stl"), lambda f: load_mesh(f / "a.stl"), ours=False),
    "mesh.ply": Kind(box("a.ply"), lambda f: load_mesh(f / "a.ply"), ours=False),
    "bag": Kind(lambda f, n: make_bag(f / "a.bag", D405, L515, compress=True), play_all, ours=False),
    "L515's bag": Kind(copied("l515_2.54.2.bag"), play_all, ours=False),
    "database": Kind(copied("d405_2.58.4.db3"), play_all, ours=False),
    "database of PNG": Kind(copied("d405_2.59.1.db3"), play_all, ours=False),
}


# What tests start in processes of their own, which import it from here


def keep_writing(said, name, folder, first):
    heard_of = False
    for n in itertools.count(first):
        try:
            KINDS[name].write(folder, n % 2)
        except TactuneError:  # such as a name that the other writer has taken, often several times in a row
            continue
        if not heard_of:
            said.send("written")
            heard_of = True


def write_once(said, name, folder, limit):
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
    try:
        KINDS[name].write(folder, 1)
    except TactuneError as error:
        said.send(str(error))
    except BaseException as error:
        said.send(error)
    else:
        said.send("")


def set_values(said, file, who):
    application()
    settings = Settings(file)
    for number in range(50):
        settings.set(f"{who}/{number}", number)
        settings.sync()
