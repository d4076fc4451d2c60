"""A row that shows what jobs do: a progress bar with the step in words, and Cancel."""

from __future__ import annotations

from functools import partial

from PyQt6.QtWidgets import QWidget

from ...widgets.basics.controls import ProgressBar, push_button
from ...widgets.basics.layouts import hbox
from .jobs import Job


class JobRow(QWidget):
    """Visible while one of the jobs reports progress; work that reports none, as on each frame, shows nothing."""

    def __init__(self, *jobs: Job) -> None:
        super().__init__()
        self.bar, self.cancel = ProgressBar(), push_button("Cancel", "Cancel")
        self.bar.setAccessibleName("Progress")
        hbox((self.bar, 1), self.cancel, within=self, margins=0)
        policy = self.sizePolicy()
        policy.setRetainSizeWhenHidden(True)  # so that the layout does not jump
        self.setSizePolicy(policy)
        for job in jobs:
            job.progress.connect(self._show)
            job.busyChanged.connect(partial(self._end, jobs))
            self.cancel.clicked.connect(job.cancel)
        self.hide()

    def _show(self, share: float, words: str) -> None:
        """Show a share, 0 to 1, and the step; a share of 0 means unknown."""
        self.bar.setRange(0, 100 if share > 0 else 0)
        self.bar.show_share(share, words)
        self.setVisible(share < 1)

    def _end(self, jobs: tuple[Job, ...], _busy: bool) -> None:
        if not any(job.busy for job in jobs):
            self.hide()
