"""What happens beside the frames: contact tests are compiled, and the newest frame is examined for findings."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from pathlib import Path
from threading import Thread

from ...core.contact import CONTACT_TESTS
from ...core.preset import Preset
from ...core.rig.untouched import FoundUntouched
from ...core.tuning.advice.findings import Examiner, unusable_test
from ...core.tuning.advice.proposal import Finding
from ...core.warmup import is_compiled, warm_up_if_needed, warm_up_views
from .results import Result, SourceInfo

_Kernels = tuple[str, bool]


class BackgroundCompiler:
    """Compiles the kernels of the contact tests: first those that are asked for, then the others."""

    def __init__(self, changed: Callable[[], object]) -> None:
        self._changed = changed
        self._ready: set[_Kernels] = set()
        self._wanted: Preset | None = None
        self._looked_behind: Preset | None = None
        self._thread: Thread | None = None
        self._words = ""
        self._stopping = False

    @property
    def busy(self) -> bool:
        return self._thread is not None

    def missing(self, preset: Preset) -> str:
        """Return how far the compilation of a preset's contact test is; empty if its frames need not wait."""
        if self._is_ready(preset):
            if not self.busy and preset is not self._looked_behind:
                self._looked_behind = preset
                names = [name for name in CONTACT_TESTS if (name, preset.averaged_frames > 1) not in self._ready]
                others = (preset.with_value("contact_test", name) for name in names)
                self._wanted = next((other for other in others if not self._is_ready(other)), None)
            return ""
        self._wanted = preset
        self._looked_behind = None
        return self._words or f"Compiling the {preset.contact_test} test for this computer"

    def _is_ready(self, preset: Preset) -> bool:
        """Return whether a test need not be compiled; one that somebody adds is compiled by its first frame."""
        if _kernels_of(preset) not in self._ready and is_compiled(preset):
            self._ready.add(_kernels_of(preset))
        return _kernels_of(preset) in self._ready

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
        self._thread, self._looked_behind = None, None
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


#: Shortest time between two examinations, seconds: they take a small share of the thread's time.
INTERVAL_S = 1.0


class StoredUntouched:
    """The stored untouched frame of a preset, beside the file ``home``; read again only if another one is named."""

    def __init__(self) -> None:
        self.home: Path | None = None
        self._key: object = None
        self._found = FoundUntouched(None)

    def __call__(self, info: SourceInfo, preset: Preset) -> FoundUntouched:
        key = info, preset.untouched, self.home
        if key != self._key:
            self._key, self._found = key, info.kept_untouched(preset, self.home)
        return self._found

    def forget(self) -> None:
        self._key = None


class Examination:
    """Examines results; for the worker's thread only."""

    def __init__(self) -> None:
        self._result: Result | None = None  # not examined yet
        self._examiner: Examiner | None = None
        self._info: SourceInfo | None = None
        self._ended_s = -INTERVAL_S

    def note(self, result: Result) -> None:
        """Examine this result when it is due."""
        self._result = result

    def forget(self) -> None:
        self._result, self._examiner, self._info = None, None, None

    def wait_s(self) -> float | None:
        """Seconds until the next examination is due (0: now); None while there is nothing new to examine."""
        if self._result is None:
            return None
        return max(0.0, self._ended_s + INTERVAL_S - time.perf_counter())

    def findings(self) -> tuple[tuple[Finding, ...], Preset]:
        """Return what is wrong with the newest result, and its preset; call it only when that is due."""
        result, self._result = self._result, None
        assert result is not None
        untouched = result.untouched
        if result.patch is None:
            unusable = unusable_test(result.preset, result.source.rig, untouched)
            return () if unusable is None else (unusable,), result.preset
        if self._examiner is None or result.source is not self._info:
            self._examiner, self._info = Examiner(result.source.rig), result.source
        found = self._examiner.findings(result.frame, result.patch, result.preset, untouched)
        self._ended_s = time.perf_counter()
        return found, result.preset
