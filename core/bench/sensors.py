"""Run time against error of the contact tests on simulated sensors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from ..evaluation.sensor_table import AVERAGED, METHODS, SHIPPED, TOLERANCE_TESTS
from ..evaluation.table import average
from ..evaluation.table_cell import TableCell
from ..evaluation.table_report import aligned


@dataclass(frozen=True)
class SensorTiming:
    """One contact test on one sensor.

    Attributes
    ----------
    sensor : str
    method : str
        One of `sensor_table.METHODS`.
    test : str
        ``tolerance`` for all tolerances, ``membrane`` or ``averaged``.
    ms : float
        Median time per frame.
    rmse_mm : float
        Mean symmetric RMSE over scenes and seeds.
    """

    sensor: str
    method: str
    test: str
    ms: float
    rmse_mm: float


def sensor_timings(cells: Sequence[TableCell]) -> list[SensorTiming]:
    """Return time and error of the contact tests, for each sensor; those that found nothing are left out."""
    tests = {**dict.fromkeys(TOLERANCE_TESTS, "tolerance"), SHIPPED: "membrane", AVERAGED: "averaged"}
    timings = []
    for sensor in dict.fromkeys(cell.sensor for cell in cells):
        for method in filter(tests.__contains__, METHODS):
            mine = [cell for cell in cells if (cell.sensor, cell.method) == (sensor, method)]
            times = [cell.ms for cell in mine if cell.ms is not None and not cell.failure]
            rmse_mm = average(mine, "rmse_mm").mean
            if times and math.isfinite(rmse_mm):
                timings.append(SensorTiming(sensor, method, tests[method], median(times), rmse_mm))
    return timings


def timings_as_text(timings: Sequence[SensorTiming]) -> str:
    """Return a table as text, one line per sensor and contact test."""
    lines = [(it.sensor, it.method, f"{it.ms:.1f}", f"{it.rmse_mm:.2f}") for it in timings]
    return aligned([("sensor", "contact test", "ms", "RMSE mm"), *lines])
