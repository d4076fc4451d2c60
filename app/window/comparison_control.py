"""Lets a person compare two presets: what the panel offers, what the keys do, and where the wipe stands."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import Final

from PyQt6.QtCore import QObject, pyqtSignal

from ...core.errors import TactuneError
from ...core.preset.file import shipped_presets
from ...core.sources.presets import load_preset
from ...widgets.basics.messages import Severity
from ..context import TASK, Context
from ..document.comparison import PRESENT, Side, Sides, take_over
from .actions import Actions
from .comparison_panel import ComparisonPanel, Offer, Shown
from .files import PRESET_FILTER
from .frame_presenter import FramePresenter

#: Share of the width by which a key moves the wipe.
STEP: Final = 0.05
#: Interval between updates of the numbers while frames play, in seconds.
INTERVAL_S: Final = 0.2
#: Number of newest steps of the history that are offered.
_MAX_STEPS: Final = 40
_NEXT: Final = {Shown.A: Shown.B, Shown.B: Shown.WIPE}


class ComparisonControl(QObject):
    """Connects `Context.comparison` with the worker, the views, the panel and the actions.

    Signals
    -------
    wantedChanged()
        `shows_difference` has changed.
    runningChanged(bool)
        A comparison was started or ended.
    """

    wantedChanged = pyqtSignal()
    runningChanged = pyqtSignal(bool)

    def __init__(self, context: Context, actions: Actions, panel: ComparisonPanel, presenter: FramePresenter) -> None:
        super().__init__(context)
        self._context, self._document, self._comparison = context, context.document, context.comparison
        self._actions, self._panel, self._presenter = actions, panel, presenter
        self._mode = Shown.WIPE
        self._share = 0.5
        self._running = False
        self._last: Sides | None = None
        self._numbers_s = 0.0
        self._comparison.changed.connect(self._changed)
        context.frameShown.connect(self._show_numbers)
        self._connect_panel()
        self._connect_actions()
        self._enable(False)

    @property
    def shows_difference(self) -> bool:
        """Whether the patch view shows the difference of both patches."""
        return self._running and self._mode is Shown.DIFFERENCE

    @property
    def share(self) -> float:
        """Share of the width that shows A."""
        return {Shown.A: 1.0, Shown.B: 0.0}.get(self._mode, self._share)

    def show_changes(self) -> None:
        """Compare the preset as it was saved with the present one."""
        self._comparison.show(self._comparison.saved, self._comparison.present)

    def move_wipe(self, share: float) -> None:
        """Put the wipe at a share of the width, 0 to 1."""
        self._share = min(max(share, 0.0), 1.0)
        self.show_mode(Shown.DIFFERENCE if self._mode is Shown.DIFFERENCE else Shown.WIPE)

    def show_mode(self, mode: Shown) -> None:
        """Show the wipe, one side, or the difference of both patches."""
        difference = self.shows_difference
        self._mode = mode
        self._panel.show_mode(mode)
        self._presenter.set_wipe_share(self.share)
        if self.shows_difference != difference:
            self.wantedChanged.emit()

    # Connections

    def _connect_panel(self) -> None:
        panel = self._panel
        panel.modeChosen.connect(self.show_mode)
        panel.swapRequested.connect(self._swap)
        panel.useRequested.connect(self._use)
        panel.closeRequested.connect(self._comparison.end)
        for index, box in enumerate(panel.boxes):
            box.opening.connect(partial(self._offer, index))

    def _connect_actions(self) -> None:
        actions = self._actions
        actions.changes_since_save.triggered.connect(self.show_changes)
        actions.compare.triggered.connect(lambda wanted: self._start() if wanted else self._comparison.end())
        actions.next_side.triggered.connect(lambda: self.show_mode(_NEXT.get(self._mode, Shown.A)))
        actions.patch_difference.triggered.connect(
            lambda: self.show_mode(Shown.WIPE if self._mode is Shown.DIFFERENCE else Shown.DIFFERENCE)
        )
        actions.wipe_left.triggered.connect(lambda: self.move_wipe(self.share - STEP))
        actions.wipe_right.triggered.connect(lambda: self.move_wipe(self.share + STEP))

    def _enable(self, running: bool) -> None:
        actions = self._actions
        for action in (actions.next_side, actions.patch_difference, actions.wipe_left, actions.wipe_right):
            action.setEnabled(running)
        actions.compare.setChecked(running)

    # Comparing

    def _start(self) -> None:
        """Compare the same sides as last time; at first the saved preset with the present one."""
        if self._last is None:
            self.show_changes()
        else:
            a, b = map(self._comparison.up_to_date, self._last)
            self._comparison.show(a, b)

    def _changed(self, sides: Sides | None) -> None:
        self._context.worker.set_compared(sides)
        if sides is not None:
            self._last = sides
            self._panel.show_sides(sides)
            for index in (0, 1):
                if self._panel.boxes[index].currentText() != sides[index].name:
                    self._offer(index)
        if (sides is not None) == self._running:
            return
        self._running = sides is not None
        self._enable(self._running)
        if self._running:
            self._share = 0.5
            self.show_mode(Shown.WIPE)
        self.wantedChanged.emit()
        self.runningChanged.emit(self._running)

    def _show_numbers(self) -> None:
        result = self._context.result
        if result is None or result.compared is None:
            return
        now = time.perf_counter()
        if not result.playback.running or now - self._numbers_s >= INTERVAL_S:
            self._numbers_s = now
            self._panel.show_frame(result.compared)

    def _swap(self) -> None:
        if self._comparison.sides is not None:
            a, b = self._comparison.sides
            self._comparison.show(b, a)

    def _use(self, index: int) -> None:
        sides = self._comparison.sides
        if sides is not None and take_over(self._document, sides[index]):
            self._comparison.end()

    # Sides

    def _offer(self, index: int) -> None:
        """Fill the list of one side."""
        sides = self._comparison.sides
        if sides is None:
            return
        comparison = self._comparison
        own: list[Offer] = [
            (PRESENT, lambda: self._choose(index, comparison.present)),
            (comparison.saved.name, lambda: self._choose(index, comparison.saved)),
        ]
        history = [
            Side(f"Step {number}: {text}" if number else "Step 0: as opened", preset)
            for number, (text, preset) in enumerate(self._document.history())
        ]
        steps: list[Offer] = [
            (side.name, partial(self._choose, index, side)) for side in reversed(history[-_MAX_STEPS:])
        ]
        others: list[Offer] = [
            (f"Shipped: {name}", partial(self._load, index, f"Shipped: {name}", name)) for name in shipped_presets()
        ]
        others.append(("File…", partial(self._ask_file, index)))
        self._panel.boxes[index].offer([own, steps if len(history) > 1 else [], others], sides[index])

    def _choose(self, index: int, side: Side) -> None:
        """Compare with another side."""
        if self._comparison.sides is not None:
            a, b = (side if place == index else other for place, other in enumerate(self._comparison.sides))
            self._comparison.show(a, b)
            self._offer(index)

    def _load(self, index: int, name: str, place: Path | str) -> None:
        try:
            side = Side(name, load_preset(place))
        except TactuneError as error:
            self._context.messages.show_message("comparison", Severity.ERROR, str(error), subject=TASK)
            self._offer(index)
        else:
            self._choose(index, side)

    def _ask_file(self, index: int) -> None:
        self._offer(index)
        self._context.dialogs.open_file(
            "preset", "Compare with a preset", PRESET_FILTER, lambda path: self._load(index, path.name, path)
        )
