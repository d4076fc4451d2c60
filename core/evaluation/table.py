"""The paper's table: methods on scenes with ground truth, with averages over scenes and seeds.

Cells are measured one by one and stored, so a cancelled table can be resumed.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from statistics import mean, median, stdev
from typing import Final

from scipy.stats import t as student_t

from ..methods.registry import make_method
from ..preset import Preset
from ..rig.untouched import untouched_frame
from ..sources.base import FrameSource
from ..sources.registry import open_source
from .table_cell import (
    FRAMES_PER_CELL,
    PRESSES,
    MakeMethod,
    PlannedScene,
    TableCell,
    TableCellFolder,
    build_method,
    run_method,
    score_run,
    table_methods,
)

#: Symmetric RMSE in mm at low, medium and high strain, and seconds a frame, as in Yin et al.
PAPER_RMSE_MM: Final = {
    "fusion": (2.70, 2.33, 2.78),
    "proximity-only": (3.73, 5.33, 4.33),
    "tactile-only": (4.09, 4.05, 4.03),
    "mechanics": (13.73, 9.10, 7.69),
}
PAPER_SECONDS: Final = {"fusion": 0.07, "proximity-only": 0.03, "tactile-only": 0.03, "mechanics": 0.3}

#: Fields of a cell that are averaged over the scenes with contact.
MEASURES: Final = (
    "rmse_mm", "iou", "precision", "recall", "hausdorff_mm", "p95_mm", "chamfer_mm", "area_error_mm2", "boundary_px",
)  # fmt: skip

CONFIDENCE: Final = 0.95


def paper_method(method: str) -> str:
    """Return the method of the paper that a method is compared with."""
    if method in PAPER_RMSE_MM:
        return method
    return "tactile-only" if method.startswith("tactile") else "fusion"


@dataclass(frozen=True)
class TablePlan:
    """Methods, scenes and seeds of a table.

    Attributes
    ----------
    methods : tuple of str
        Names from `table_methods`.
    scenes : tuple of PlannedScene
    seeds : tuple of int
        Noise seeds.
    preset : Preset
        Used by all methods; `STRAIGHT` replaces its alignment model and tolerance.
    work : Path
        Folder of finished cells.
    """

    methods: tuple[str, ...]
    scenes: tuple[PlannedScene, ...]
    seeds: tuple[int, ...]
    preset: Preset
    work: Path

    @property
    def count(self) -> int:
        """Number of cells."""
        return len(self.methods) * len(self.scenes) * len(self.seeds)


def measure_table(
    plan: TablePlan,
    make: MakeMethod = make_method,
    open_scene: Callable[[str], FrameSource] = open_source,
) -> Iterator[TableCell]:
    """Yield the cells of a table; cells stored in ``plan.work`` are not measured again.

    Stop iterating to cancel: all yielded cells are stored.

    Raises
    ------
    TactuneError
        A scene cannot be opened or a cell cannot be stored.
    """
    folder = TableCellFolder(plan.work, plan.preset)
    for scene in plan.scenes:
        with _SceneFrames(scene, open_scene) as shown:
            for seed in plan.seeds:
                for method in plan.methods:
                    cells = folder.load([method], scene, seed)
                    if cells is None:
                        cells = [shown.measure(method, seed, plan.preset, make)]
                        folder.save(cells, scene)
                    yield from cells


class _SceneFrames(ExitStack):
    """Frames of one scene, one seed at a time, opened only if a cell must be measured.

    The sources of all seeds stay open until the end because they share the solved membrane.
    """

    def __init__(self, scene: PlannedScene, open_scene: Callable[[str], FrameSource]) -> None:
        super().__init__()
        self._scene, self._open = scene, open_scene
        self._seed = -1

    def measure(self, method: str, seed: int, preset: Preset, make: MakeMethod) -> TableCell:
        """Measure one method; if it cannot be built or fails, the cell holds the error message."""
        if seed != self._seed:
            self._source = self.enter_context(self._open(f"{self._scene.source}&seed={seed}"))
            self._untouched = untouched_frame(self._source)
            self._frames = list(itertools.islice(self._source, FRAMES_PER_CELL))
            self._seed = seed
        untouched, rig = self._untouched, self._source.rig
        run = run_method(lambda: build_method(method, preset, rig, untouched, make), self._frames)
        return score_run(method, self._scene, seed, run, self._frames[-1], rig)


@dataclass(frozen=True)
class Average:
    """A mean over scenes and seeds.

    Attributes
    ----------
    mean : float
        nan if every cell failed.
    half_width : float
        Half width of the 95 % confidence interval of the mean over seeds (Student's t-distribution); nan for a single
        seed.
    failed, cells : int
        Number of failed cells, and of all cells.
    """

    mean: float
    half_width: float
    failed: int
    cells: int

    @property
    def low(self) -> float:
        """Lower confidence bound."""
        return self.mean - self.half_width

    @property
    def high(self) -> float:
        """Upper confidence bound."""
        return self.mean + self.half_width


def average(cells: Iterable[TableCell], measure: str) -> Average:
    """Average a field of cells: over sides, then over scenes, then over seeds.

    Cells without this field, such as failed ones, are left out; failed cells are counted.
    """
    cells = list(cells)
    by_seed: dict[int, dict[tuple[str, str], list[float]]] = {}
    for cell in cells:
        number = getattr(cell, measure)
        if number is not None:
            by_seed.setdefault(cell.seed, {}).setdefault((cell.row, cell.press), []).append(number)
    of_seeds = [mean(mean(sides) for sides in scenes.values()) for scenes in by_seed.values()]
    half_width = math.nan
    if len(of_seeds) > 1:
        quantile = float(student_t.ppf((1 + CONFIDENCE) / 2, len(of_seeds) - 1))
        half_width = quantile * stdev(of_seeds) / math.sqrt(len(of_seeds))
    failed = sum(1 for cell in cells if cell.failure)
    return Average(mean(of_seeds) if of_seeds else math.nan, half_width, failed, len(cells))


@dataclass(frozen=True)
class Table:
    """Finished cells and their averages."""

    cells: list[TableCell] = field(default_factory=list)

    @property
    def methods(self) -> list[str]:
        """The methods, in the order of `table_methods`."""
        order = table_methods()
        names = list(dict.fromkeys(cell.method for cell in self.cells))
        return sorted(names, key=lambda name: order.index(name) if name in order else len(order))

    @property
    def seeds(self) -> list[int]:
        """The seeds."""
        return sorted({cell.seed for cell in self.cells})

    def rows(self, group: str) -> list[tuple[str, str]]:
        """Return (object or special scene, press) of a group, in the order of the plan."""
        return list(dict.fromkeys((cell.row, cell.press) for cell in self.cells if cell.group == group))

    def presses(self) -> list[str]:
        """Return the presses of the paper's scenes."""
        found = {press for _, press in self.rows("main")}
        return [press for press in PRESSES if press in found]

    def pick(self, method: str, group: str, row: str | None = None, press: str | None = None) -> list[TableCell]:
        """Return the cells of a method in a group, optionally of one row and press only."""
        return [
            cell
            for cell in self.cells
            if (cell.method, cell.group) == (method, group) and row in (None, cell.row) and press in (None, cell.press)
        ]

    def median_ms(self, method: str) -> float:
        """Return the median time per frame, milliseconds; nan if nothing was timed."""
        times = [cell.ms for cell in self.cells if cell.method == method and cell.ms is not None]
        return median(times) if times else math.nan


def seeds_from(first: int, count: int) -> tuple[int, ...]:
    """Return ``count`` consecutive seeds."""
    return tuple(range(first, first + count))


def contacts_right(cells: Sequence[TableCell]) -> float:
    """Return the share of cells whose patch has the true number of separate contacts; nan without counts."""
    counted = [cell for cell in cells if cell.true_contacts is not None]
    judged = [cell.contacts == cell.true_contacts and not cell.failure for cell in counted]
    return sum(judged) / len(judged) if judged else math.nan
