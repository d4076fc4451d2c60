"""One table cell: one method on one simulated scene with one seed, measured once and stored."""

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
from typing import Any, Final, Literal

from ..errors import TactuneError
from ..methods.method import ContactMethod, MethodPatch
from ..methods.registry import make_method, method_names
from ..model.clouds import pixel_areas_m2
from ..model.files import atomic_path
from ..model.frames import Rig, SensorFrame
from ..preset import Preset
from ..sources.simulator.scenes import HELD_OUT
from .metrics import (
    area_error_mm2,
    boundary_distance_px,
    cloud_distances,
    method_area_mm2,
    pixel_scores,
    separate_contacts,
    truth_cloud,
)

Group = Literal["main", "extra", "hover"]

PRESSES: Final = ("low", "medium", "high")
OBJECTS: Final = ("octopus", "cup", "cube")
#: How far the object of the false-positive test stays away from the membrane.
GAPS_MM: Final = (1, 2, 3, 5, 10, 20)
#: Held-out seeds begin here, so that no seed of development is among them.
FIRST_HELD_OUT_SEED: Final = 100
#: What the paper has: its alignment and its tolerance.
STRAIGHT: Final = "straight"
STRAIGHT_T: Final = 0.03

#: Frames that a method is shown, each once, since the pipeline computes no frame twice. The first loads
#: code and tables and is not timed; the last is judged. Only methods that remember frames are shown all.
FRAMES_PER_CELL: Final = 16
_FRAMES_WITHOUT_MEMORY: Final = 4

NO_CONTACT_FOUND = "it found no contact where there is one"

MakeMethod = Callable[[str, Preset, Rig, SensorFrame | None], ContactMethod]


@dataclass(frozen=True)
class PlannedScene:
    """One scene of the table.

    Attributes
    ----------
    name : str
        The simulator's scene.
    object : str
        What is pressed in.
    press : str
        ``low``, ``medium``, ``high``; a gap in millimetres for ``hover``.
    side : str
        ``left`` or ``right`` for high presses, which are off the middle; else empty.
    group : {"main", "extra", "hover"}
        Whether it is one of the paper's cells, a scene beyond them, or one without contact.
    """

    name: str
    object: str
    press: str
    side: str = ""
    group: Group = "main"

    @property
    def row(self) -> str:
        """What the table calls it, the press apart: the object, or the special scene."""
        return self.object if self.name == self.object else self.name

    @property
    def source(self) -> str:
        """The source's name without a seed, as `open_source` takes it."""
        options = [f"gap={self.press}" if self.group == "hover" else f"press={self.press}"]
        options += [f"side={self.side}"] * bool(self.side) + [f"object={self.object}"] * (self.name != self.object)
        return f"sim:{self.name}?{'&'.join(options)}"


def plan_scenes(
    objects: Sequence[str] = OBJECTS, presses: Sequence[str] = PRESSES, *, extra: bool = True, held_out: bool = False
) -> list[PlannedScene]:
    """List the scenes of a table.

    Parameters
    ----------
    objects, presses : sequence of str
        The paper's are the default.
    extra : bool
        Also a membrane of varied stiffness, a wrinkled one, two objects at once, and objects that hover.
    held_out : bool
        The objects are held out of development: they may be planned, and no other.

    Raises
    ------
    TactuneError
        An object or press that there is not, or a held-out object where none is wanted.
    """
    known = HELD_OUT if held_out else (*OBJECTS, "two")
    for what, names, allowed in (("object", objects, known), ("press", presses, PRESSES)):
        for name in names:
            if name not in allowed:
                hint = "; it is kept for --held-out" if name in HELD_OUT else ""
                raise TactuneError(f"the table has no {what} {name!r}{hint}; choose of {', '.join(allowed)}")
    scenes = [scene for name in dict.fromkeys(objects) for press in dict.fromkeys(presses)
              for scene in _still(name, press)]  # fmt: skip
    if extra:
        pressed = objects[0] if held_out else "cup"
        scenes += [PlannedScene(name, pressed, "medium", group="extra") for name in ("stiff", "wrinkled")]
        if not held_out and "two" not in objects:
            scenes += [scene for press in ("medium", "high") for scene in _still("two", press, "extra")]
        scenes += [PlannedScene("hover", pressed, str(gap), group="hover") for gap in GAPS_MM]
    return scenes


def _still(name: str, press: str, group: Group = "main") -> list[PlannedScene]:
    sides = ("right", "left") if press == "high" else ("",)
    return [PlannedScene(name, name, press, side, group) for side in sides]


@dataclass(frozen=True)
class TableCell:
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
) -> TableCell:
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
        return TableCell(*where, **strain, failure=str(error))
    assert patch is not None
    scores = _scores(patch, frames[-1], rig)
    return TableCell(*where, **(scores | strain), ms=median(times_ms[1:] or times_ms))


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


class TableCellFolder:
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
        self._settings = f"{settings} {STRAIGHT_T} {FRAMES_PER_CELL} {code_version()}"

    def load(self, method: str, scene: PlannedScene, seed: int) -> TableCell | None:
        """Return a cell, or None where it is not kept or its file is damaged."""
        try:
            found = json.loads(self._path(method, scene, seed).read_text(encoding="utf-8"))
            cell = table_cell_from_json(found)
        except (OSError, ValueError, TypeError):
            return None
        return cell if (cell.method, cell.source, cell.seed) == (method, scene.source, seed) else None

    def save(self, cell: TableCell, scene: PlannedScene) -> None:
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


def table_cell_from_json(found: Any) -> TableCell:
    """Return the cell that a JSON object tells.

    Raises
    ------
    ValueError
        The object is no cell: a field is missing, unknown or of another type.
    """
    names = {field.name: field.type for field in fields(TableCell)}
    if not isinstance(found, dict) or found.keys() != names.keys():
        raise ValueError("it has not the fields of a cell")
    for name, kind in names.items():
        value = found[name]
        allowed = {"str": (str,), "int": (int,)}.get(str(kind), (int, float, type(None)))
        if not isinstance(value, allowed) or isinstance(value, bool):
            raise ValueError(f"{name} is {value!r}")
    return TableCell(**found)


@cache
def code_version() -> str:
    """Return a hash of everything that can change a result: the source code of the core."""
    digest = hashlib.sha256()
    core = Path(__file__).parents[1]
    for file in sorted(core.rglob("*.py")):
        digest.update(str(file.relative_to(core)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()
