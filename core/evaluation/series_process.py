"""A process of low priority that computes time series beside a window: orders on standard input, values on output.

An order is one line of JSON, ``{"id": ..., "source": ..., "length": ..., "preset": "...", "skip": [...]}``: the number
of frames that the window knows, the preset as the text of its file, and the frames that are known. It ends the order
before it; without a source it does nothing else. All orders name the same source. Answers are lines of JSON with the
order's id: ``{"id": ..., "rows": [[index, ...], ...]}`` with the fields of `FrameValues`, then
``{"id": ..., "done": true}`` or ``{"id": ..., "problem": "..."}``. The process ends with its standard input.
"""

from __future__ import annotations

import json
import math
import os
import sys
import time
from contextlib import suppress
from dataclasses import astuple
from queue import SimpleQueue
from threading import Thread
from typing import Any, Final

import cv2

from ..contact.kernels.threads import set_threads
from ..errors import SourceError, TactuneError
from ..preset.file import preset_from_text
from ..sources.base import FrameSource
from ..sources.registry import open_source
from .time_series import FrameValues, time_series, visiting_order

#: What a fresh interpreter runs; its argument is the import path as JSON.
PROGRAM: Final = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from tactune.core.evaluation.series_process import main; main()"
)
#: Interval between two lines of values, seconds.
_INTERVAL_S: Final = 0.2

Order = dict[str, Any]


def main() -> None:
    """Obey orders until standard input ends."""
    with suppress(OSError, AttributeError):  # Windows has no nice
        os.nice(19)  # playback and everything else of the user come first
    set_threads(1)
    cv2.setNumThreads(1)
    orders: SimpleQueue[Order] = SimpleQueue()
    Thread(target=_read_orders, args=(orders,), daemon=True).start()
    worker = _Worker(orders)
    while True:
        worker.obey(orders.get())


def _read_orders(orders: SimpleQueue[Order]) -> None:
    for line in sys.stdin:
        orders.put(json.loads(line))
    os._exit(0)  # the window has gone


class _Worker:
    """Keeps the source open, which is the same in all orders."""

    def __init__(self, orders: SimpleQueue[Order]) -> None:
        self._orders = orders
        self._source: FrameSource | None = None

    def obey(self, order: Order) -> None:
        """Compute the series of an order, unless a newer one comes."""
        if order["source"] is None:
            return
        try:
            source = self._source = self._source or open_source(order["source"])
            if source.length != order["length"]:
                was = f"not {order['length']} as when it was opened"
                raise SourceError(f"{source.name} has {source.length} frames, {was}; open it again")
            preset = preset_from_text(order["preset"], "the preset")
            skip = set(order["skip"])
            frames = [index for index in visiting_order(source.length or 0, preset) if index not in skip]
            waiting: list[FrameValues] = []
            told_s = time.monotonic()
            for values in time_series(source, preset, frames):
                if not self._orders.empty():
                    return
                waiting.append(values)
                if time.monotonic() - told_s >= _INTERVAL_S:
                    _tell(order, rows=_rows(waiting))
                    waiting, told_s = [], time.monotonic()
            _tell(order, rows=_rows(waiting))
            _tell(order, done=True)
        except TactuneError as error:
            _tell(order, problem=str(error))
        except Exception as error:
            _tell(order, problem=f"Something went wrong ({type(error).__name__}: {error}).")


def _rows(values: list[FrameValues]) -> list[list[float | None]]:
    return [[None if math.isnan(item) else item for item in astuple(each)] for each in values]


def _tell(order: Order, **answer: Any) -> None:
    sys.stdout.write(json.dumps({"id": order["id"], **answer}) + "\n")
    sys.stdout.flush()
