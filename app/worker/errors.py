"""Errors as the user sees them: uncaught exceptions reach the window, and each error becomes one sentence."""

from __future__ import annotations

import sys
import traceback
from collections.abc import Callable
from types import TracebackType

from PyQt6.QtCore import QObject, pyqtSignal

from ...core.errors import TactuneError, as_sentence

ExceptionHook = Callable[[type[BaseException], BaseException, TracebackType | None], object]


class ErrorHook(QObject):
    """Emits uncaught exceptions as a signal and passes them on to the previous hook.

    Without a hook, PyQt aborts the program after an exception in a slot; pyqtgraph installs a hook that
    only prints.

    Signals
    -------
    raised(sentence: str, details: str)
    """

    raised = pyqtSignal(str, str)

    def __init__(self, parent: QObject | None = None) -> None:
        super().__init__(parent)
        self._previous: ExceptionHook = sys.excepthook

    def install(self) -> None:
        self._previous, sys.excepthook = sys.excepthook, self._handle

    def remove(self) -> None:
        if sys.excepthook == self._handle:
            sys.excepthook = self._previous

    def _handle(self, kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
        if issubclass(kind, Exception):
            details = "".join(traceback.format_exception(kind, error, trace))
            sentence = f"Something went wrong ({kind.__name__}: {error}). Your work is kept; save it to be sure."
            self.raised.emit(sentence, details)
        self._previous(kind, error, trace)


def guarded(act: Callable[[], object]) -> None:
    """Call ``act``; an exception is reported to `sys.excepthook` and does not end the caller."""
    try:
        act()
    except Exception as error:
        sys.excepthook(type(error), error, error.__traceback__)


def explain(error: Exception, what: str) -> str:
    """Return an error as one sentence: the message of a `TactuneError`, else ``what`` failed and the error."""
    if isinstance(error, TactuneError):
        return str(error)
    return as_sentence(f"{what} ({type(error).__name__}: {error})")
