"""Opening a source: with progress, and with a way out."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from ...core.contact.warmup import warm_up_if_needed
from ...core.errors import TactuneError
from ...core.sources.base import FrameSource, Progress

_PROGRESS_INTERVAL_S = 0.05


@dataclass(frozen=True)
class SourceRequest:
    """A source to open: what to call it meanwhile and how to open it.

    ``exclusive`` is for cameras, which only one can have: the present source is closed first.
    """

    name: str
    open: Callable[[Progress], FrameSource]
    exclusive: bool = False


class OpeningCancelledError(TactuneError):
    """Opening was given up because nobody wants the source any more."""


def open_requested(
    request: SourceRequest, wanted: Callable[[], bool], report: Callable[[float, str], None]
) -> FrameSource:
    """Compile the pipeline where that is still to do, open a source, and report progress now and then.

    Raises
    ------
    OpeningCancelledError
        ``wanted`` has become false.
    Exception
        Whatever opening it raises.
    """
    last_report_s = 0.0

    def progress(fraction: float, text: str) -> None:
        nonlocal last_report_s
        if not wanted():
            raise OpeningCancelledError(f"opening {request.name} was cancelled")
        if time.perf_counter() - last_report_s > _PROGRESS_INTERVAL_S:
            last_report_s = time.perf_counter()
            report(fraction, text)

    report(0.0, "")
    warm_up_if_needed(progress)
    source = request.open(progress)
    if not wanted():
        source.close()
        raise OpeningCancelledError(f"opening {request.name} was cancelled")
    return source
