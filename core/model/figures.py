"""Figures drawn with matplotlib, which only the extra ``lab`` installs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..errors import MissingExtraError
from .files import atomic_path


def pyplot() -> Any:
    """Import ``matplotlib.pyplot`` for drawing without a display."""
    try:
        import matplotlib
    except ImportError as error:
        raise MissingExtraError("the figure needs matplotlib: install it with pip install 'tactune[lab]'") from error
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def save_figure(figure: Any, *paths: Path, **options: Any) -> None:
    """Write a figure to files, each in the format of its suffix, and close it; ``options`` are those of ``savefig``."""
    try:
        for path in paths:
            with atomic_path(path) as temporary:
                figure.savefig(temporary, format=path.suffix[1:].lower(), **options)
    finally:
        pyplot().close(figure)
