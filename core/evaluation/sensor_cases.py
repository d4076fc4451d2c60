"""The cases of a table of sensors: means over objects and seeds, and whether the shipped contact test is good enough.

It is compared with the *oracle*, the tolerance test with the tolerance that is best on each single frame (only the
truth tells which), and with the *best fixed t*, the one tolerance that is best on the mean of all cases.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from statistics import fmean, median
from typing import Final

from .sensor_table import AVERAGED, SHIPPED, TOLERANCE_TESTS
from .table import average
from .table_cell import NO_CONTACT_FOUND, PRESSES, STRAIGHT, TableCell

#: Largest RMSE of the shipped test, as a multiple of the oracle's.
MAX_OVER_ORACLE: Final = 1.05
#: Smallest contact in which an empty patch is a failure, mm^2.
MIN_TOUCHED_MM2: Final = 200.0

ORACLE: Final = "oracle"
BEST_FIXED: Final = "best fixed t"
#: Methods of a case, in the order of the report.
SHOWN: Final = (STRAIGHT, BEST_FIXED, ORACLE, SHIPPED, AVERAGED)


@dataclass(frozen=True)
class SensorCase:
    """One sensor, membrane and press.

    Attributes
    ----------
    sensor, membrane, press : str
    rmse_mm : dict of str to float
        Mean RMSE of the methods in `SHOWN`; nan if no frame has a patch.
    over_best, over_oracle : float
        RMSE of the shipped test divided by that of the best fixed t and of the oracle, on the frames where both have a
        patch; nan if there is none.
    frames : int
    empty : int
        Frames without a shipped patch although at least `MIN_TOUCHED_MM2` touch.
    empty_small : int
        Frames without a shipped patch where less touches; they are left out of the mean.
    failed : int
        Frames on which the shipped test gave an error.
    """

    sensor: str
    membrane: str
    press: str
    rmse_mm: dict[str, float]
    over_best: float
    over_oracle: float
    frames: int
    empty: int
    empty_small: int
    failed: int

    @property
    def holds_best(self) -> bool:
        """Whether the shipped test is at least as good as the best fixed t, or that one finds nothing."""
        return not self.over_best > 1.0

    @property
    def holds_oracle(self) -> bool:
        """Whether the shipped test is at most 5 % above the oracle, or the oracle finds nothing."""
        return not self.over_oracle > MAX_OVER_ORACLE

    @property
    def holds_found(self) -> bool:
        """Whether the shipped test found a patch in every frame where enough touches."""
        return self.empty == self.failed == 0

    @property
    def holds(self) -> bool:
        """Whether all of these hold."""
        return self.holds_best and self.holds_oracle and self.holds_found


@dataclass(frozen=True)
class SensorTable:
    """Finished cells and their cases.

    Attributes
    ----------
    cells : list of TableCell
        All methods of `sensor_table.METHODS` on the same frames.
    best_t : float
        The best fixed tolerance; nan if no tolerance finds anything.
    cases : list of SensorCase
        In the order of the cells.
    """

    cells: list[TableCell]
    best_t: float
    cases: list[SensorCase]

    @property
    def sensors(self) -> list[str]:
        """The sensors, in the order of the cells."""
        return list(dict.fromkeys(case.sensor for case in self.cases))

    @property
    def presses(self) -> list[str]:
        """The presses, from low to high."""
        found = {case.press for case in self.cases}
        return [press for press in PRESSES if press in found]

    @property
    def seeds(self) -> list[int]:
        """The seeds."""
        return sorted({cell.seed for cell in self.cells})

    @property
    def failing(self) -> list[SensorCase]:
        """The cases that do not hold."""
        return [case for case in self.cases if not case.holds]

    def pick(self, sensor: str = "", press: str = "") -> list[SensorCase]:
        """Return the cases of a sensor and press; of all, where empty."""
        return [case for case in self.cases if sensor in ("", case.sensor) and press in ("", case.press)]

    def median_ms(self, method: str, sensor: str = "", press: str = "") -> float:
        """Return the median time per frame, milliseconds; nan if nothing was timed."""
        times = [
            cell.ms
            for cell in self.cells
            if cell.method == method and cell.ms is not None
            and sensor in ("", cell.sensor) and press in ("", cell.press)
        ]  # fmt: skip
        return median(times) if times else math.nan


#: One scored frame: source and seed.
_Frame = tuple[str, int]
_Case = tuple[str, str, str]


def sensor_table(cells: Sequence[TableCell]) -> SensorTable:
    """Return the cases of finished cells."""
    cases: dict[_Case, dict[str, list[TableCell]]] = {}
    for cell in cells:
        methods = cases.setdefault((cell.sensor, cell.membrane, cell.press), {})
        methods.setdefault(cell.method, []).append(cell)
    best = _best_fixed(list(cases.values()))
    return SensorTable(
        list(cells), TOLERANCE_TESTS.get(best, math.nan), [_case(key, cases[key], best) for key in cases]
    )


def worst_case(cases: Sequence[SensorCase]) -> SensorCase | None:
    """Return a case in which a patch is missing, otherwise that with the largest ratio to the oracle."""
    missing = [case for case in cases if not case.holds_found]
    known = [case for case in cases if math.isfinite(case.over_oracle)]
    return missing[0] if missing else max(known, key=lambda case: case.over_oracle, default=None)


def finite_mean(numbers: Iterable[float]) -> float:
    """Return the mean of the finite numbers, nan if there is none."""
    finite = [number for number in numbers if math.isfinite(number)]
    return fmean(finite) if finite else math.nan


def oracle_cells(methods: dict[str, list[TableCell]]) -> list[TableCell]:
    """Return, for each frame, the cell of the tolerance with the lowest RMSE; without RMSE where all are empty."""
    return [
        replace(min(frame, key=lambda cell: math.inf if cell.rmse_mm is None else cell.rmse_mm), method=ORACLE)
        for frame in _by_frame(methods).values()
    ]


def _best_fixed(cases: Sequence[dict[str, list[TableCell]]]) -> str:
    """Return the tolerance test with the lowest mean over the cases, or an empty text.

    An empty patch counts as the largest RMSE that any tolerance has on that frame. Frames in which no tolerance finds
    contact do not count.
    """
    means: dict[str, list[float]] = {}
    for methods in cases:
        counted: dict[str, list[TableCell]] = {}
        for frame in _by_frame(methods).values():
            known = [cell.rmse_mm for cell in frame if cell.rmse_mm is not None]
            for cell in frame if known else ():
                rmse_mm = max(known) if cell.rmse_mm is None else cell.rmse_mm
                counted.setdefault(cell.method, []).append(replace(cell, rmse_mm=rmse_mm))
        for name, cells in counted.items():
            means.setdefault(name, []).append(average(cells, "rmse_mm").mean)
    return min(means, key=lambda name: fmean(means[name]), default="")


def _by_frame(methods: dict[str, list[TableCell]]) -> dict[_Frame, list[TableCell]]:
    """Return the cells of the tolerance tests, frame by frame."""
    frames: dict[_Frame, list[TableCell]] = {}
    for name in TOLERANCE_TESTS:
        for cell in methods.get(name, ()):
            frames.setdefault((cell.source, cell.seed), []).append(cell)
    return frames


def _case(key: _Case, methods: dict[str, list[TableCell]], best: str) -> SensorCase:
    shown = {**methods, BEST_FIXED: methods.get(best, []), ORACLE: oracle_cells(methods)}
    shipped = methods.get(SHIPPED, [])
    empty = [cell for cell in shipped if cell.failure == NO_CONTACT_FOUND]
    large = sum(1 for cell in empty if (cell.true_mm2 or 0.0) >= MIN_TOUCHED_MM2)
    return SensorCase(
        *key,
        rmse_mm={name: average(shown.get(name, []), "rmse_mm").mean for name in SHOWN},
        over_best=_ratio(shipped, shown[BEST_FIXED]),
        over_oracle=_ratio(shipped, shown[ORACLE]),
        frames=len(shipped),
        empty=large,
        empty_small=len(empty) - large,
        failed=sum(1 for cell in shipped if cell.failure) - len(empty),
    )


def _ratio(ours: Sequence[TableCell], theirs: Sequence[TableCell]) -> float:
    """Return the ratio of the mean RMSE on the frames where both have one; nan if there is none."""
    known = [{(cell.source, cell.seed) for cell in cells if cell.rmse_mm is not None} for cells in (ours, theirs)]
    common = known[0] & known[1]
    if not common:
        return math.nan
    mine, other = (
        average([cell for cell in cells if (cell.source, cell.seed) in common], "rmse_mm").mean
        for cells in (ours, theirs)
    )
    return mine / other if other > 0 else (1.0 if mine == 0 else math.inf)
