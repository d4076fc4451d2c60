"""Compiles contact tests on a thread of its own, so that the window shows frames meanwhile."""

from __future__ import annotations

import logging
from collections.abc import Callable
from threading import Thread

from ...core.preset import Preset
from ...core.warmup import is_compiled, warm_up_if_needed, warm_up_views

_Kernels = tuple[str, bool]


class BackgroundCompiler:
    """Compiles the kernels of the contact tests that are asked for, one test after the other."""

    def __init__(self, changed: Callable[[], object]) -> None:
        self._changed = changed
        self._ready: set[_Kernels] = set()
        self._wanted: Preset | None = None
        self._thread: Thread | None = None
        self._words = ""
        self._stopping = False

    @property
    def busy(self) -> bool:
        return self._thread is not None

    def missing(self, preset: Preset) -> str:
        """Return how far the compilation of a preset's contact test is; empty if its frames need not wait.

        A test that is not compiled is taken up by the next `start`.
        """
        kernels = _kernels_of(preset)
        if kernels in self._ready:
            return ""
        if is_compiled(preset):
            self._ready.add(kernels)
            return ""
        self._wanted = preset
        return self._words or f"Compiling the {preset.contact_test} test for this computer"

    def start(self) -> None:
        """Begin to compile the test that was missing last, unless one is being compiled."""
        preset, self._wanted = self._wanted, None
        if preset is not None and self._thread is None:
            self._thread = Thread(target=self._compile, args=(preset,), name="compiler", daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """Compile no further kernel, and wait for the present one."""
        self._stopping = True
        if (thread := self._thread) is not None:
            thread.join()

    def _compile(self, preset: Preset) -> None:
        try:
            warm_up_if_needed(self._tell, preset)
            self._end(preset)
            warm_up_views(preset.contact_test)
        except _StoppedError:
            return
        except Exception:  # the first frame meets the same error and tells it
            logging.getLogger(__name__).exception("The contact test could not be compiled in advance.")
            self._end(preset)
        self._thread = None
        self._changed()  # another test may be missing by now

    def _tell(self, _share: float, words: str) -> None:
        if self._stopping:
            raise _StoppedError
        self._words = words
        self._changed()

    def _end(self, preset: Preset) -> None:
        self._words = ""
        self._ready.add(_kernels_of(preset))
        self._changed()


class _StoppedError(Exception):
    """The window closes."""


def _kernels_of(preset: Preset) -> _Kernels:
    return preset.contact_test, preset.averaged_frames > 1
