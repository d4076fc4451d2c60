"""Progress on standard error: a bar on a terminal, a sentence elsewhere before a long preparation."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Self

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


class CliProgress:
    """Shows how far a command has come; a context manager.

    Parameters
    ----------
    quiet : bool
        No bar, because something else is written to the same terminal.
    """

    def __init__(self, quiet: bool = False) -> None:
        self._on_terminal = sys.stderr.isatty()
        # The bar must leave standard output alone: it may be a pipe or a file with JSON lines.
        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            console=Console(stderr=True),
            transient=True,
            redirect_stdout=False,
            redirect_stderr=False,
            disable=quiet or not self._on_terminal,
        )
        self._task = self._bar.add_task("", visible=False)
        self._announced = False

    def preparing(self, share: float, what: str) -> None:
        """Tell the share done, 0 to 1, of preparing a source."""
        if 0 < share < 1 and not self._on_terminal and not self._announced:
            self._announced = True
            typer.echo(f"tactune: {what} ...", err=True)
        self._bar.update(self._task, description=what, completed=round(100 * share), total=100, visible=share < 1)

    def frames(self, done: int, total: int | None, what: str = "frames") -> None:
        """Tell the number of frames done, and of how many where that is known."""
        self._bar.update(self._task, description=what, completed=done, total=total, visible=True)

    def __enter__(self) -> Self:
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()
