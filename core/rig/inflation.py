"""Measures the pressure of the inflation from presses whose force a scale or a force sensor has read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from ..calibration.points import read_table
from ..errors import CalibrationError, foreign
from ..model.arrays import Float64Array
from ..model.frames import SensorFrame
from ..model.patch import ContactPatch

#: The force of a press stands out of its noise by this many standard deviations.
_SIGMAS: Final = 3.0
#: Error of the relative force that all presses of a rig share, larger by a factor where one is weak, and largest
#: residual of presses that fit together.
_SHARED_ERROR, _WEAKER, _LARGEST_RESIDUAL = 0.05, 2.0, 0.5
#: What a membrane can be pressed with, N, and the largest usual pressure of a soft one, Pa.
_FORCES_N: Final = 1e-3, 1e3
_USUAL_PA: Final = 10_000.0
_STAMPS_FROM_S: Final = 1e8  # three years
_COLUMNS: Final = "frame,force_n or time_s,force_n"


class Press(NamedTuple):
    """A force that was read beside a frame, and what the pressure test found in that frame."""

    frame: int
    force_n: float
    area_mm2: float  # Force over inflation
    area_sigma_mm2: float
    weak: tuple[str, ...] = ()  # Why its force may be off by more, in words

    @classmethod
    def of(cls, patch: ContactPatch, frame: int, force_n: float) -> Press:
        """Return the press in a frame; `CalibrationError` if it tells nothing of the inflation."""
        facts = patch.pressure
        if facts is None:
            raise CalibrationError("no contact pressure was computed; set the contact test to pressure")
        if not facts.agrees:
            raise CalibrationError(f"force and pressure disagree in frame {frame}; press in the centre, not at the rim")
        if not _FORCES_N[0] <= force_n <= _FORCES_N[1]:
            raise CalibrationError(f"the force is {force_n:g} N; give what the scale reads while the object presses")
        force, sigma = np.array(facts.force_mm2), np.array(facts.force_sigma_mm2)
        area = float(np.linalg.norm(force))
        spread = float(np.linalg.norm(force * sigma)) / area if area > 0 else math.inf
        if not area > _SIGMAS * spread:
            raise CalibrationError(f"no press stands out of the noise in frame {frame}; press more firmly")
        reasons = {"at the rim": facts.at_rim, "noise not measured": not facts.noise_known}
        return cls(frame, force_n, area, spread, tuple(reason for reason, so in reasons.items() if so))


class Inflation(NamedTuple):
    """The gauge pressure of the inflation as fitted."""

    pascals: float
    sigma_pa: float
    residual_n: float  # Root mean square
    presses: int
    weak: tuple[str, ...]  # Of any press

    @property
    def changes(self) -> dict[str, float]:
        """The preset fields that keep it."""
        return {"pressure.gauge_pa": round(self.pascals, 2), "pressure.gauge_sigma_pa": round(self.sigma_pa, 2)}

    @property
    def sentence(self) -> str:
        left = "" if self.presses == 1 else f"; the forces differ from the fit by {self.residual_n:.2g} N"
        plural = "press" if self.presses == 1 else "presses"
        weak = f"; doubtful, since {' and '.join(self.weak)}" if self.weak else ""
        weak += "; few membranes stand so much: are the forces in newtons?" if self.pascals > _USUAL_PA else ""
        return f"inflation {self.pascals:,.0f} ± {self.sigma_pa:,.0f} Pa from {self.presses} {plural}{left}{weak}"


def fit_inflation(presses: Sequence[Press]) -> Inflation:
    """Fit one pressure p to F = p A, with the weights of the areas' noise.

    Its standard deviation is the larger one of what the noise predicts and of the spread of F / A, not of its mean: the
    air of a closed membrane gives way, so p is not the same in each press. To that adds the error of the model, which
    all presses share. `CalibrationError` if the forces do not follow the frames.
    """
    if not presses:
        raise CalibrationError("there is no press; add frames in which an object presses, each with its force")
    force_n = np.array([press.force_n for press in presses])
    area_m2 = np.array([press.area_mm2 for press in presses]) * 1e-6
    weight = (np.array([press.area_sigma_mm2 for press in presses]) * 1e-6) ** -2.0
    known = float(weight @ area_m2**2)
    pascals = float(weight @ (area_m2 * force_n)) / known
    left_n = force_n - pascals * area_m2
    residual_n, count = math.sqrt(float(np.mean(left_n**2))), len(presses)
    if residual_n > _LARGEST_RESIDUAL * float(np.mean(force_n)):
        raise CalibrationError(
            f"the forces do not follow the frames: they differ from a fit by {residual_n:.2g} N, their mean is "
            f"{np.mean(force_n):.2g} N; look whether each force belongs to its frame, and whether the scale was at zero"
        )
    spread_pa = math.sqrt(float(weight @ left_n**2) / known) if count > 1 else 0.0
    weak = tuple(sorted({reason for press in presses for reason in press.weak}))
    shared_pa = _SHARED_ERROR * pascals * (_WEAKER if weak else 1.0)
    sigma_pa = math.hypot(max(pascals / math.sqrt(known), spread_pa), shared_pa)
    return Inflation(pascals, sigma_pa, residual_n, count, weak)


class Forces(NamedTuple):
    """A log of forces: by the number of a frame, or by the time, (N,) each, increasing.

    Times since the first frame are small, stamps as `tactune run --json` prints them count from 1970.
    """

    by_time: bool
    at: Float64Array
    force_n: Float64Array

    def of(self, frame: SensorFrame, start_s: float) -> float | None:
        """Return the force at a frame, between times interpolated; None where there is none."""
        if not self.by_time:
            found = np.flatnonzero(self.at == frame.sequence)
            return float(self.force_n[found[0]]) if len(found) else None
        time_s = frame.proximity_time_s - (start_s if self.at[0] < _STAMPS_FROM_S else 0.0)
        if not self.at[0] <= time_s <= self.at[-1]:
            return None
        return float(np.interp(time_s, self.at, self.force_n))


def read_forces(path: Path | str) -> Forces:
    """Read a CSV file with the columns ``frame`` or ``time_s`` (since the first frame, or stamps) and ``force_n``.

    Raises
    ------
    CalibrationError
        The file cannot be read, lacks a column or has an invalid row; the message names line and value.
    """
    header, rows = read_table(path, "forces")
    keys = [name for name in ("frame", "time_s") if name in header]
    if len(keys) != 1 or "force_n" not in header:
        raise CalibrationError(f"{path}: the columns are {foreign(', '.join(header), 80) or 'missing'}; use {_COLUMNS}")
    places = header.index(keys[0]), header.index("force_n")
    table = np.full((len(rows), 2), math.nan)
    for index, (line, row) in enumerate(rows):
        for column, place in enumerate(places):
            text = row[place] if place < len(row) else ""
            with suppress(ValueError):
                table[index, column] = float(text)
            if not math.isfinite(table[index, column]):
                raise CalibrationError(f"{path}, line {line}: {header[place]} is {foreign(text, 40)!r}, not a number")
    if not len(table):
        raise CalibrationError(f"{path} has no row; it should have the columns {_COLUMNS}")
    table = table[np.argsort(table[:, 0], kind="stable")]
    twice = np.flatnonzero(np.diff(table[:, 0]) == 0)
    if len(twice):
        raise CalibrationError(f"{path}: {keys[0]} {table[twice[0], 0]:g} is there twice; remove one row")
    return Forces(keys[0] == "time_s", table[:, 0], table[:, 1])
