"""Measures the strain in a frame on another thread, and paints the map over the colour image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import cv2
import numpy as np

from ...core.evaluation.strain.average import average_still
from ...core.evaluation.strain.strain import (
    GridCells,
    StrainError,
    StrainMeasurement,
    grid_cells,
    indentation_m,
    measure_strain,
)
from ...core.model.arrays import Float64Array, Uint8Array
from ...core.model.frames import Rig, SensorFrame, TrueStrain
from ...widgets.basics.colormaps import depth_lut
from ..calibration.pictures import pack_rgb

#: Share of the map's colour over the image, and the bits of a pixel's fraction in which squares are drawn.
_OPACITY = 0.7
_SHIFT = 4
#: The colours end at a multiple of this, 10 %.
_ROUNDED = 0.10


class MapOf(StrEnum):
    """The strain that the map's colours show."""

    LARGEST = "Largest"
    LENGTH = "Along length"
    WIDTH = "Along width"


@dataclass(frozen=True, eq=False)
class StrainTask:
    """The input of one measurement.

    Attributes
    ----------
    frames : sequence of SensorFrame
        The newest frame last; earlier ones are averaged with it where nothing has moved.
    number : int
        Number of the newest frame, counted from 1.
    untouched : SensorFrame or None
        The untouched membrane.
    """

    frames: Sequence[SensorFrame]
    number: int
    rig: Rig
    spacing_m: float
    untouched: SensorFrame | None

    @property
    def frame(self) -> SensorFrame:
        """The newest frame."""
        return self.frames[-1]


@dataclass(frozen=True, eq=False)
class StrainView:
    """One measurement, or the reason why there is none.

    Attributes
    ----------
    averaged : int
        Number of averaged frames.
    color : uint8, shape (H, W, 3), or None
        The tactile colour image.
    displacement_mm : float or None
        Displacement from the untouched frame.
    problem : str
        The reason why ``measured`` is None; else empty.
    """

    task: StrainTask
    averaged: int
    color: Uint8Array | None
    measured: StrainMeasurement | None = None
    cells: GridCells | None = None
    displacement_mm: float | None = None
    truth: TrueStrain | None = None
    problem: str = ""


def examine(task: StrainTask) -> StrainView:
    """Measure the strain of the newest frame; if that fails, `StrainView.problem` says why.

    Raises
    ------
    FrameError
        The frames belong to another rig.
    """
    frame, averaged = average_still(_numbered(task), task.rig)
    truth = frame.truth.strain if frame.truth is not None else None
    displacement_mm = None
    try:
        if task.untouched is not None:
            displacement_mm = 1e3 * indentation_m(frame, task.untouched, task.rig)
        measured = measure_strain(frame, task.rig, task.spacing_m)
    except StrainError as error:
        return StrainView(
            task, averaged, frame.tactile_color, displacement_mm=displacement_mm, truth=truth, problem=str(error)
        )
    return StrainView(task, averaged, frame.tactile_color, measured, grid_cells(measured), displacement_mm, truth)


def _numbered(task: StrainTask) -> list[SensorFrame]:
    """Return the frames numbered as windows show them, because errors name frames by number."""
    shift = task.number - task.frame.sequence
    return [replace(frame, sequence=frame.sequence + shift) for frame in task.frames]


def values_of(cells: GridCells, shown: MapOf) -> Float64Array:
    """Return the strain that colours each square, shape (K,)."""
    return {MapOf.LARGEST: cells.largest, MapOf.LENGTH: cells.length, MapOf.WIDTH: cells.width}[shown]


def color_range(values: Float64Array) -> tuple[float, float]:
    """Return the range of the colours: multiples of `_ROUNDED` that contain all values."""
    if len(values) == 0:
        return 0.0, _ROUNDED
    low = min(float(np.floor(values.min() / _ROUNDED)) * _ROUNDED, 0.0)
    return low, max(float(np.ceil(values.max() / _ROUNDED)) * _ROUNDED, low + _ROUNDED)


def paint(view: StrainView, shown: MapOf) -> Uint8Array | None:
    """Return the colour image with coloured grid squares, in the memory layout of ``QImage.Format_RGB32``."""
    if view.color is None:
        return None
    image = view.color.copy()
    if view.measured is not None and view.cells is not None:
        values = values_of(view.cells, shown)
        low, high = color_range(values)
        rows = np.clip((values - low) / (high - low) * 255.0, 0, 255).astype(np.intp)
        places = np.rint(view.measured.pixels[view.cells.corners] * (1 << _SHIFT)).astype(np.int32)
        for corners, row in zip(places, rows, strict=True):
            color = [int(channel) for channel in map_lut()[row, :3]]
            cv2.fillConvexPoly(image, corners, color, cv2.LINE_AA, _SHIFT)
        image = np.asarray(cv2.addWeighted(image, _OPACITY, view.color, 1.0 - _OPACITY, 0.0), dtype=np.uint8)
    return pack_rgb(image)


def map_lut() -> Uint8Array:
    """Return the map's colours, low to high: uint8 (256, 4)."""
    return np.ascontiguousarray(depth_lut()[::-1])
