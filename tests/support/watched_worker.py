"""A worker without a window, and everything that it said."""

from __future__ import annotations

from tactune.app.worker.results import Result
from tactune.app.worker.worker import SourceRequest, Worker
from tactune.core.preset import Preset
from tactune.core.sources.base import FrameSource


class Watched:
    """A worker and lists of what it said."""

    def __init__(self, preset: Preset) -> None:
        worker = self.worker = Worker(preset)
        self.results: list[Result] = []
        self.opened, self.failures, self.open_failures, self.progress = [], [], [], []
        self.modes, self.states, self.options, self.refusals = [], [], [], []
        worker.resultReady.connect(lambda: self.results.append(worker.take()))
        worker.opened.connect(self.opened.append)
        worker.failed.connect(self.failures.append)
        worker.openFailed.connect(lambda *what: self.open_failures.append(what))
        worker.opening.connect(lambda *what: self.progress.append(what))
        worker.playbackChanged.connect(self.modes.append)
        worker.stateChanged.connect(self.states.append)
        worker.optionsChanged.connect(self.options.append)
        worker.optionRefused.connect(self.refusals.append)
        worker.start()

    def open(self, source: FrameSource) -> None:
        self.worker.open(SourceRequest(source.name, lambda progress: source))

    @property
    def last(self) -> Result | None:
        return self.results[-1] if self.results else None

    def shows(self, index: int) -> bool:
        return self.last is not None and self.last.playback.index == index
