"""One table cell: one method on one simulated scene with one seed, measured once and stored."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cache
from pathlib import Path
from statistics import median
from typing import Any, Final, Literal

from ..errors import TactuneError
from ..methods.method import ContactMethod, MethodPatch
from ..methods.registry import make_method, method_names
from ..model.arrays import Float32Array
from ..model.clouds import pixel_areas_m2
from ..model.files import atomic_path, json_fields
from ..model.frames import Rig, SensorFrame
from ..model.loading import read_json
from ..preset import Preset
from ..sources.simulator.scenes import HELD_OUT
from .metrics import (
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
#: Gaps between object and membrane in the false-positive test, millimetres.
GAPS_MM: Final = (1, 2, 3, 5, 10, 20)
#: First seed of held-out tables; development uses smaller seeds only.
FIRST_HELD_OUT_SEED: Final = 100
#: The paper's method: homography alignment and the paper's tolerance.
STRAIGHT: Final = "straight"
STRAIGHT_T: Final = 0.03
#: Sensor of the simulator that the documented figures hold for.
DOCUMENTED_SENSOR: Final = "datasheet"

#: Frames per table cell. A method gets each frame once. The first one loads code and tables and is not timed; the last
#: one is scored. Methods without memory get only the last `_FRAMES_WITHOUT_MEMORY`.
FRAMES_PER_CELL: Final = 16
_FRAMES_WITHOUT_MEMORY: Final = 4

NO_CONTACT_FOUND = "it found no contact although there is one"

MakeMethod = Callable[[str, Preset, Rig, SensorFrame | None], ContactMethod]


@dataclass(frozen=True)
class PlannedScene:
    """One scene of the table.

    Attributes
    ----------
    name : str
        Name of the simulator's scene.
    object : str
        Name of the pressed object.
    press : str
        ``low``, ``medium``, ``high``; for ``hover`` the gap in millimetres.
    side : str
        ``left`` or ``right`` for high presses, which are off-centre; otherwise empty.
    group : {"main", "extra", "hover"}
        The paper's scenes, further scenes, and scenes without contact.
    sensor, membrane : str
        Names of the simulator's sensor and membrane. An empty name leaves the choice to the simulator. The documented
        figures hold for `DOCUMENTED_SENSOR`.
    """

    name: str
    object: str
    press: str
    side: str = ""
    group: Group = "main"
    sensor: str = DOCUMENTED_SENSOR
    membrane: str = ""

    @property
    def row(self) -> str:
        """Name of the table row: the object, or the special scene."""
        return self.object if self.name == self.object else self.name

    @property
    def source(self) -> str:
        """Source string for `open_source`, without a seed."""
        options = [f"gap={self.press}" if self.group == "hover" else f"press={self.press}"]
        options += [f"side={self.side}"] * bool(self.side) + [f"object={self.object}"] * (self.name != self.object)
        options += [f"membrane={self.membrane}"] * bool(self.membrane) + [f"sensor={self.sensor}"] * bool(self.sensor)
        return f"sim:{self.name}?{'&'.join(options)}"


def plan_scenes(
    objects: Sequence[str] = OBJECTS, presses: Sequence[str] = PRESSES, *, extra: bool = True, held_out: bool = False
) -> list[PlannedScene]:
    """List the scenes of a table.

    Parameters
    ----------
    objects, presses : sequence of str
        Default: those of the paper.
    extra : bool
        Add a membrane of varying stiffness, a wrinkled membrane, two objects at once, and hovering objects.
    held_out : bool
        Allow the objects held out of development, and only those.

    Raises
    ------
    TactuneError
        An object or press is unknown, or a held-out object is given without ``held_out``.
    """
    check_choice("the table", "object", objects, HELD_OUT if held_out else (*OBJECTS, "two"), HELD_OUT)
    check_choice("the table", "press", presses, PRESSES)
    scenes = [scene for name in dict.fromkeys(objects) for press in dict.fromkeys(presses)
              for scene in _still(name, press)]  # fmt: skip
    if extra:
        pressed = objects[0] if held_out else "cup"
        scenes += [PlannedScene(name, pressed, "medium", group="extra") for name in ("stiff", "wrinkled")]
        if not held_out and "two" not in objects:
            scenes += [scene for press in ("medium", "high") for scene in _still("two", press, "extra")]
        scenes += [PlannedScene("hover", pressed, str(gap), group="hover") for gap in GAPS_MM]
    return scenes


def check_choice(
    owner: str, what: str, names: Sequence[str], allowed: Sequence[str], held_out: Collection[str] = ()
) -> None:
    """Raise `TactuneError` for a name that is not allowed; ``what`` it names and ``owner``, who knows it, are words."""
    for name in names:
        if name not in allowed:
            choose = f"choose from {', '.join(allowed)}"
            if name in held_out:
                raise TactuneError(f"the {what} {name!r} is held out; add --held-out, or {choose}")
            raise TactuneError(f"{owner} has no {what} {name!r}; {choose}")


def _still(name: str, press: str, group: Group = "main") -> list[PlannedScene]:
    sides = ("right", "left") if press == "high" else ("",)
    return [PlannedScene(name, name, press, side, group) for side in sides]


@dataclass(frozen=True)
class TableCell:
    """Result of one method on one scene with one seed. Numbers that do not exist are None.

    Attributes
    ----------
    method, row, object, press, side, group, source, seed, sensor, membrane
        Method, scene (see `PlannedScene`) and noise seed.
    rmse_mm, hausdorff_mm, p95_mm, chamfer_mm : float or None
        Distances to the true contact; see `CloudDistances`.
    iou, precision, recall : float or None
        See `PixelScores`; over proximity pixels.
    area_error_mm2 : float or None
        Area of the patch minus that of the true contact.
    boundary_px : float or None
        See `boundary_distance_px`.
    points : int
        Number of points of the patch; without contact, all of them are false.
    max_strain, strain_length, strain_width : float or None
        Largest in-plane strain of the scene (see `TrueStrain`); None if unknown.
    contacts, true_contacts : int or None
        Number of separate contacts in the patch, and in the truth; None if not counted.
    true_mm2 : float or None
        Area of the true contact.
    ms : float or None
        Median computation time per frame.
    failure : str
        Why the method returned no patch; empty if it did.
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
    contacts: int | None = None
    true_contacts: int | None = None
    ms: float | None = None
    max_strain: float | None = None
    strain_length: float | None = None
    strain_width: float | None = None
    true_mm2: float | None = None
    failure: str = ""
    sensor: str = ""
    membrane: str = ""


def table_methods() -> tuple[str, ...]:
    """Return the names of the table's methods: the paper's own (`STRAIGHT`), then all of the registry."""
    return (STRAIGHT, *method_names())


def build_method(
    name: str, preset: Preset, rig: Rig, untouched: SensorFrame | None, make: MakeMethod = make_method
) -> ContactMethod:
    """Build a method of the table by its name. Errors: see `make_method`."""
    if name == STRAIGHT:
        return make("fusion-homography", preset.with_values({"tolerance.t": STRAIGHT_T}), rig, untouched)
    return make(name, preset, rig, untouched)


@dataclass(frozen=True, eq=False)
class MethodRun:
    """What a method found in the last frame of a scene.

    Attributes
    ----------
    patch : MethodPatch or None
        None if the method could not be built or raised an error.
    ms : float or None
        Median computation time per frame.
    error : str
        The error message; empty if there was none.
    """

    patch: MethodPatch | None
    ms: float | None = None
    error: str = ""


def run_method(build: Callable[[], ContactMethod], frames: Sequence[SensorFrame], warm: bool = False) -> MethodRun:
    """Run one method on the frames of a still scene. Its errors are part of the result.

    Parameters
    ----------
    build : callable
    frames : sequence of SensorFrame
    warm : bool
        Run on the last frame only: the method has no memory and has been used before.
    """
    try:
        method = build()
        times_ms, patch = [], None
        for frame in frames[-1:] if warm else frames[-max(method.remembers, _FRAMES_WITHOUT_MEMORY) :]:
            started = time.perf_counter_ns()
            patch = method.find(frame)
            times_ms.append((time.perf_counter_ns() - started) / 1e6)
    except TactuneError as error:
        return MethodRun(None, error=str(error))
    return MethodRun(patch, median(times_ms[1:] or times_ms))


#: Returns the fields of a `TableCell` that compare a patch with the truth of its frame.
Scores = Callable[[MethodPatch, SensorFrame, Rig], dict[str, Any]]


def score_run(
    name: str,
    scene: PlannedScene,
    seed: int,
    run: MethodRun,
    frame: SensorFrame,
    rig: Rig,
    scores: Scores | None = None,
) -> TableCell:
    """Score what a method found in the last frame of a scene. A failed run gives a cell with the error message.

    Raises
    ------
    TactuneError
        The scene has no ground truth.
    """
    where = (name, scene.row, scene.object, scene.press, scene.side, scene.group, scene.source, seed)
    known = {**_strain(frame), "sensor": scene.sensor, "membrane": scene.membrane}
    if run.patch is None:
        return TableCell(*where, **known, failure=run.error)
    return TableCell(*where, **((scores or all_scores)(run.patch, frame, rig) | known), ms=run.ms)


def _strain(frame: SensorFrame) -> dict[str, Any]:
    known = frame.truth.strain if frame.truth is not None else None
    if known is None:
        return {}
    return {"max_strain": known.largest, "strain_length": known.length, "strain_width": known.width}


def true_contact(frame: SensorFrame, rig: Rig) -> tuple[Float32Array, float]:
    """Return the points of the true contact (metres, proximity depth frame) and its area in mm^2.

    Raises
    ------
    TactuneError
        The frame has no ground truth.
    """
    if frame.truth is None:
        raise TactuneError("the scene has no ground truth, so no method can be scored on it; choose a simulated one")
    points = truth_cloud(frame.truth, rig).points
    return points, 1e6 * float(pixel_areas_m2(points[:, 2], rig.proximity.intrinsics).sum())


def all_scores(patch: MethodPatch, frame: SensorFrame, rig: Rig) -> dict[str, Any]:
    """Score a patch against its frame's ground truth in all measures. Errors: see `true_contact`."""
    truth, truth_mm2 = true_contact(frame, rig)
    assert frame.truth is not None
    true_contacts = separate_contacts(frame.truth.contact)
    if reason := failure_of(patch, truth):
        return {"failure": reason, "true_contacts": true_contacts, "true_mm2": truth_mm2}
    pixels = pixel_scores(patch.mask, frame.truth.contact)
    apart = cloud_distances(patch.points, truth)
    numbers = {
        "rmse_mm": 1e3 * apart.symmetric_rmse_m,
        "hausdorff_mm": 1e3 * apart.hausdorff_m,
        "p95_mm": 1e3 * apart.percentile_95_m,
        "chamfer_mm": 1e3 * apart.chamfer_m,
        "iou": pixels.iou,
        "precision": pixels.precision,
        "recall": pixels.recall,
        "area_error_mm2": method_area_mm2(patch, rig) - truth_mm2,
        "boundary_px": boundary_distance_px(patch.mask, frame.truth.contact),
    }
    known = json_fields(numbers)
    contacts = {"contacts": separate_contacts(patch.mask), "true_contacts": true_contacts}
    return known | contacts | {"points": len(patch.points), "true_mm2": truth_mm2}


def failure_of(patch: MethodPatch, truth: Float32Array) -> str:
    """Return why a patch cannot be scored: its failure, or that it is empty although something touches."""
    return patch.failure or (NO_CONTACT_FOUND if len(patch.points) == 0 and len(truth) > 0 else "")


class TableCellFolder:
    """Stores finished cells in JSON files, so that an interrupted table can be resumed.

    Parameters
    ----------
    folder : path
        Created with the first stored cell.
    preset : Preset
        Used by all methods. Cells of another preset or another program version are not reused.
    variant : str
        Anything else on which all cells depend.
    """

    def __init__(self, folder: Path, preset: Preset, variant: str = "") -> None:
        self.folder = folder
        settings = preset.model_dump_json(exclude={"name", "notes", "created", "modified"})
        self._settings = f"{settings} {STRAIGHT_T} {FRAMES_PER_CELL} {code_version()} {variant}"

    def load(self, methods: Sequence[str], scene: PlannedScene, seed: int) -> list[TableCell] | None:
        """Return the cells of these methods that `save` stored together, or None if they are missing or damaged."""
        try:
            cells = [table_cell_from_json(found) for found in read_json(self._path(methods, scene, seed))]
        except (OSError, ValueError, TypeError):
            return None
        known = [(cell.method, cell.source, cell.seed) for cell in cells]
        return cells if known == [(method, scene.source, seed) for method in methods] else None

    def save(self, cells: Sequence[TableCell], scene: PlannedScene) -> None:
        """Store the cells of some methods on one scene with one seed in one file, atomically.

        Raises
        ------
        ExportError
            The folder cannot be written.
        """
        with atomic_path(self._path([cell.method for cell in cells], scene, cells[0].seed)) as temporary:
            temporary.write_text(json.dumps([asdict(cell) for cell in cells], allow_nan=False), encoding="utf-8")

    def _path(self, methods: Sequence[str], scene: PlannedScene, seed: int) -> Path:
        name = methods[0] if len(methods) == 1 else "all"
        text = json.dumps([*methods, asdict(scene), seed, self._settings])
        return self.folder / f"{name}-{hashlib.sha256(text.encode()).hexdigest()[:24]}.json"


def table_cell_from_json(found: Any) -> TableCell:
    """Return the cell from a JSON object.

    Raises
    ------
    ValueError
        A field is missing, unknown or of another type.
    """
    names = {field.name: field.type for field in fields(TableCell)}
    if not isinstance(found, dict) or found.keys() != names.keys():
        raise ValueError("its fields are not those of a table cell")
    for name, kind in names.items():
        value = found[name]
        allowed = {"str": (str,), "int": (int,)}.get(str(kind), (int, float, type(None)))
        if not isinstance(value, allowed) or isinstance(value, bool):
            raise ValueError(f"{name} is {value!r}")
    return TableCell(**found)


@cache
def code_version() -> str:
    """Return a hash of the core's source code, on which every result depends."""
    digest = hashlib.sha256()
    core = Path(__file__).parents[1]
    for file in sorted(core.rglob("*.py")):
        digest.update(str(file.relative_to(core)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()
