"""One cell of the table: one method on one scene with one seed, measured once and kept."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path
from statistics import median
from typing import Any, Final

from ..contact.outliers.clusters import pixel_areas_m2
from ..errors import TactuneError
from ..methods.method import ContactMethod, MethodPatch
from ..methods.registry import make_method, method_names
from ..model.files import atomic_path
from ..model.frames import Rig, SensorFrame
from ..preset import Preset
from .distances import area_error_mm2, boundary_distance_px, cloud_distances, separate_contacts
from .metrics import method_area_mm2, pixel_scores, truth_cloud
from .scene_plan import PlannedScene

#: What the paper has: its alignment and its tolerance.
STRAIGHT: Final = "straight"
STRAIGHT_T: Final = 0.03

#: Frames that a method is shown, each once, since the pipeline computes no frame twice. The first loads
#: code and tables and is not timed; the last is judged. Only methods that remember frames are shown all.
FRAMES_A_CELL: Final = 16
_FRAMES_WITHOUT_MEMORY: Final = 4

NO_CONTACT_FOUND = "it found no contact where there is one"

MakeMethod = Callable[[str, Preset, Rig, SensorFrame | None], ContactMethod]


@dataclass(frozen=True)
class Cell:
    """What was measured; numbers are None where they do not exist, such as distances to an empty patch.

    Attributes
    ----------
    method, row, object, press, side, group, source, seed
        What was measured; as in `PlannedScene`.
    rmse_mm, hausdorff_mm, p95_mm, chamfer_mm : float or None
        As in `CloudDistances`.
    iou, precision, recall : float or None
        In proximity pixels.
    area_error_mm2, boundary_px : float or None
        As in `area_error_mm2` and `boundary_distance_px`.
    points : int
        Of the patch; where nothing touches, each is false.
    max_strain, strain_length, strain_width : float or None
        Largest in-plane strain of the scene, as in `TrueStrain`; None where nobody knows.
    contacts, true_contacts : int
        Separate contacts in the patch and in truth.
    ms : float or None
        Median computation time of a frame.
    failure : str
        Why the method gave no patch; empty where it did.
    """

    method: str
    row: str
    object: str
    press: str
    side: str
    group: str
    source: str
    seed: int
    rmse_mm: float | None = None
    hausdorff_mm: float | None = None
    p95_mm: float | None = None
    chamfer_mm: float | None = None
    iou: float | None = None
    precision: float | None = None
    recall: float | None = None
    area_error_mm2: float | None = None
    boundary_px: float | None = None
    points: int = 0
    contacts: int = 0
    true_contacts: int = 0
    ms: float | None = None
    max_strain: float | None = None
    strain_length: float | None = None
    strain_width: float | None = None
    failure: str = ""


def table_methods() -> tuple[str, ...]:
    """Return the names that the table knows: the paper's straight method, then all others."""
    return (STRAIGHT, *method_names())


def check_methods(names: Sequence[str], known: Sequence[str]) -> None:
    """Refuse a method that there is not.

    Raises
    ------
    TactuneError
        Names the method and the known ones.
    """
    for name in names:
        if name not in known:
            raise TactuneError(f"there is no method {name!r}; known are {', '.join(known)}")


def build_method(
    name: str, preset: Preset, rig: Rig, untouched: SensorFrame | None, make: MakeMethod = make_method
) -> ContactMethod:
    """Build a method of the table by its name; raises as `make_method` does."""
    if name == STRAIGHT:
        return make("fusion-homography", preset.with_values({"tolerance.t": STRAIGHT_T}), rig, untouched)
    return make(name, preset, rig, untouched)


def measure_cell(
    name: str,
    scene: PlannedScene,
    seed: int,
    build: Callable[[], ContactMethod],
    frames: Sequence[SensorFrame],
    rig: Rig,
) -> Cell:
    """Measure one method on frames of one still scene; the last one is judged.

    A method that cannot be built, or gives up, makes a cell with its failure in words.

    Raises
    ------
    TactuneError
        The scene knows no truth.
    """
    where = (name, scene.row, scene.object, scene.press, scene.side, scene.group, scene.source, seed)
    strain = _strain(frames[-1])
    try:
        method = build()
        times_ms, patch = [], None
        for frame in frames[-max(method.remembers, _FRAMES_WITHOUT_MEMORY) :]:
            started = time.perf_counter_ns()
            patch = method.find(frame)
            times_ms.append((time.perf_counter_ns() - started) / 1e6)
    except TactuneError as error:
        return Cell(*where, **strain, failure=str(error))
    assert patch is not None
    scores = _scores(patch, frames[-1], rig)
    return Cell(*where, **(scores | strain), ms=median(times_ms[1:] or times_ms))


def _strain(frame: SensorFrame) -> dict[str, Any]:
    known = frame.truth.strain if frame.truth is not None else None
    if known is None:
        return {}
    return {"max_strain": known.largest, "strain_length": known.length, "strain_width": known.width}


def _scores(patch: MethodPatch, frame: SensorFrame, rig: Rig) -> dict[str, Any]:
    """Compare a patch with its frame's truth."""
    if frame.truth is None:
        raise TactuneError("the scene knows no truth, so no method can be judged on it; choose a simulated one")
    truth = truth_cloud(frame.truth, rig).points
    true_contacts = separate_contacts(frame.truth.contact)
    if patch.failure or (len(patch.points) == 0 and len(truth) > 0):
        return {"failure": patch.failure or NO_CONTACT_FOUND, "true_contacts": true_contacts}
    pixels = pixel_scores(patch.mask, frame.truth.contact)
    apart = cloud_distances(patch.points, truth)
    truth_mm2 = 1e6 * float(pixel_areas_m2(truth[:, 2], rig.proximity.intrinsics).sum())
    numbers = {
        "rmse_mm": 1e3 * apart.symmetric_rmse_m,
        "hausdorff_mm": 1e3 * apart.hausdorff_m,
        "p95_mm": 1e3 * apart.percentile_95_m,
        "chamfer_mm": 1e3 * apart.chamfer_m,
        "iou": pixels.iou,
        "precision": pixels.precision,
        "recall": pixels.recall,
        "area_error_mm2": area_error_mm2(method_area_mm2(patch, rig), truth_mm2),
        "boundary_px": boundary_distance_px(patch.mask, frame.truth.contact),
    }
    known = {key: number if math.isfinite(number) else None for key, number in numbers.items()}
    contacts = {"contacts": separate_contacts(patch.mask), "true_contacts": true_contacts}
    return known | contacts | {"points": len(patch.points)}


class CellFolder:
    """Keeps finished cells, one JSON file each, so that an interrupted table goes on where it was.

    Parameters
    ----------
    folder : path
        Made when the first cell is kept.
    preset : Preset
        Of all methods. With another preset, or after a change of the program, cells are measured anew.
    """

    def __init__(self, folder: Path, preset: Preset) -> None:
        self.folder = folder
        settings = preset.model_dump_json(exclude={"name", "notes", "created", "modified"})
        self._settings = f"{settings} {STRAIGHT_T} {FRAMES_A_CELL} {code_version()}"

    def load(self, method: str, scene: PlannedScene, seed: int) -> Cell | None:
        """Return a cell, or None where it is not kept or its file is damaged."""
        try:
            found = json.loads(self._path(method, scene, seed).read_text(encoding="utf-8"))
            cell = cell_from_json(found)
        except (OSError, ValueError, TypeError):
            return None
        return cell if (cell.method, cell.source, cell.seed) == (method, scene.source, seed) else None

    def save(self, cell: Cell, scene: PlannedScene) -> None:
        """Keep a cell; the file appears whole or not at all.

        Raises
        ------
        ExportError
            The folder cannot be written.
        """
        with atomic_path(self._path(cell.method, scene, cell.seed)) as temporary:
            temporary.write_text(json.dumps(asdict(cell), allow_nan=False), encoding="utf-8")

    def _path(self, method: str, scene: PlannedScene, seed: int) -> Path:
        text = json.dumps([method, asdict(scene), seed, self._settings])
        return self.folder / f"{method}-{hashlib.sha256(text.encode()).hexdigest()[:24]}.json"


def cell_from_json(found: Any) -> Cell:
    """Return the cell that a JSON object tells.

    Raises
    ------
    ValueError
        The object is no cell: a field is missing, unknown or of another type.
    """
    names = {field.name: field.type for field in fields(Cell)}
    if not isinstance(found, dict) or found.keys() != names.keys():
        raise ValueError("it has not the fields of a cell")
    for name, kind in names.items():
        value = found[name]
        allowed = {"str": (str,), "int": (int,)}.get(str(kind), (int, float, type(None)))
        if not isinstance(value, allowed) or isinstance(value, bool):
            raise ValueError(f"{name} is {value!r}")
    return Cell(**found)


@cache
def code_version() -> str:
    """Return a hash of everything that can change a result: the source code of the core."""
    digest = hashlib.sha256()
    core = Path(__file__).parents[1]
    for file in sorted(core.rglob("*.py")):
        digest.update(str(file.relative_to(core)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()
