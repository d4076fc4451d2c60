"""Area, points, time and IoU of every frame of a recording, over time: first coarsely, then every frame.

They are computed in a process of low priority, so that playback keeps its rate. Window and process both import this
file; the process has no window, so nothing here imports Qt.
"""

from __future__ import annotations

import math
import os
import signal
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, fields
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from ...core.contact.kernels.threads import set_threads
from ...core.contact.pipeline import ContactPatch, ContactPipeline
from ...core.errors import FrameError, SourceError, TactuneError, as_sentence
from ...core.model.arrays import BoolArray, Float64Array
from ...core.model.frames import SensorFrame
from ...core.model.metrics import pixel_scores
from ...core.preset import Preset
from ...core.rig.untouched import kept_untouched
from ...core.sources.base import FrameSource
from ...core.sources.registry import open_source

#: The first pass takes at most about this many frames of a recording.
_FIRST_PASS: Final = 100
#: Interval between two answers of the process, seconds.
_INTERVAL_S: Final = 0.2


@dataclass(frozen=True)
class FrameValues:
    """What the time strip shows of one frame, by its index from 0; nan where it is unknown."""

    index: int
    area_mm2: float = math.nan
    points: float = math.nan
    ms: float = math.nan
    iou: float = math.nan
    force_n: float = math.nan
    force_mm2: float = math.nan


@dataclass(frozen=True)
class Order:
    """A series to compute."""

    number: int
    source: str
    length: int
    preset: Preset
    home: Path | None  # the file beside which the preset's untouched frame lies


@dataclass(frozen=True)
class Answer:
    """Values of an order's frames; at its end, ``problem`` is a sentence, or empty where the series is complete."""

    number: int
    values: list[FrameValues]
    problem: str | None = None


def frame_values(index: int, frame: SensorFrame, patch: ContactPatch) -> FrameValues:
    iou = math.nan
    if frame.truth is not None:
        iou = pixel_scores(patch.mask, frame.truth.contact).iou
    ms = sum(patch.stage_ms.values())
    force_n = math.nan if patch.force_n is None else math.hypot(*patch.force_n)
    force_mm2 = math.nan if patch.pressure is None else math.hypot(*patch.pressure.force_mm2)
    return FrameValues(index, patch.area_mm2, len(patch.points), ms, iou, force_n, force_mm2)


def visiting_order(length: int, preset: Preset) -> list[int]:
    """Return all frames: first `_FIRST_PASS` of them evenly spaced, then the others; in order if a preset averages."""
    step = 1 if preset.averaged_frames > 1 else math.ceil(length / _FIRST_PASS)
    return [*range(0, length, step), *(index for index in range(length) if index % step)]


def time_series(
    source: FrameSource, preset: Preset, order: Iterable[int], home: Path | None = None
) -> Iterator[FrameValues]:
    """Yield the values of frame after frame; a frame that cannot be read or processed has nan for all of them."""
    untouched = kept_untouched(preset, home, source).frame
    pipeline = ContactPipeline(preset, source.rig, untouched)
    for index in order:
        try:
            if source.position != index:
                source.seek(index)
            frame = source.next_frame()
            if frame is not None:
                yield frame_values(index, frame, pipeline.process(frame))
                continue
        except (SourceError, FrameError):
            pass
        yield FrameValues(index)


def serve_series(orders: Connection) -> None:
    """Obey orders until the other end closes; None or another `Order` of the same source ends the one before."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl+C to all processes; the window ends this one
    os.nice(19)  # playback and everything else of the user come first
    set_threads(1)
    cv2.setNumThreads(1)
    source: FrameSource | None = None
    with suppress(EOFError, OSError):
        while True:
            order: Order | None = orders.recv()
            if order is None:
                continue
            problem = ""
            try:
                source = source or open_source(order.source)
                _compute(source, order, orders)
            except TactuneError as error:
                problem = as_sentence(str(error))
            except (EOFError, OSError):
                raise
            except Exception as error:
                problem = f"Something went wrong ({type(error).__name__}: {error})."
            orders.send(Answer(order.number, [], problem))


def _compute(source: FrameSource, order: Order, orders: Connection) -> None:
    """Send the values of an order, unless a newer one comes."""
    if source.length != order.length:
        was = f"not {order.length} as when it was opened"
        raise SourceError(f"{source.name} has {source.length} frames, {was}; open it again")
    waiting: list[FrameValues] = []
    sent_s = time.monotonic()
    for values in time_series(source, order.preset, visiting_order(order.length, order.preset), order.home):
        if orders.poll():
            return
        waiting.append(values)
        if time.monotonic() - sent_s >= _INTERVAL_S:
            orders.send(Answer(order.number, waiting))
            waiting, sent_s = [], time.monotonic()
    orders.send(Answer(order.number, waiting))


class Series:
    """The values of a recording's frames, shape (N,) by field of `FrameValues`, and which frames were computed."""

    def __init__(self, length: int, frame_rate_hz: float, times_s: Float64Array | None = None) -> None:
        self.values: dict[str, Float64Array] = {
            field.name: np.full(length, math.nan) for field in fields(FrameValues) if field.name != "index"
        }
        self.computed: BoolArray = np.zeros(length, np.bool_)
        self.seconds = np.arange(length) / frame_rate_hz if times_s is None else times_s

    def __len__(self) -> int:
        return len(self.computed)

    @property
    def complete(self) -> bool:
        return bool(self.computed.all())

    def put(self, found: FrameValues) -> None:
        self.computed[found.index] = True
        for name, column in self.values.items():
            column[found.index] = getattr(found, name)
