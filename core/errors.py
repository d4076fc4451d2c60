"""The errors that Tactune raises on purpose.

Every message names the field or file, the value found there and what to do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any


class TactuneError(Exception):
    """Root of every error that a person or a program can act on. Its text is one line, without control characters."""

    def __str__(self) -> str:
        return printable(super().__str__().replace("\n", " "))


class PresetError(TactuneError):
    """A preset file or a preset value that cannot be used."""


class RigMismatchError(TactuneError):
    """A preset or a frame that belongs to another rig."""


class FrameError(TactuneError):
    """A frame whose arrays have the wrong type or size."""


class SourceError(TactuneError):
    """A source of frames that cannot be opened or read."""


class ExportError(TactuneError):
    """A file that cannot be written."""


class PublishError(TactuneError):
    """A live connection that cannot be opened."""


class MissingExtraError(TactuneError):
    """An optional dependency that is not installed."""


class CalibrationError(TactuneError):
    """Points that determine no alignment, or contradict each other."""


class AdviceError(TactuneError):
    """A proposal that the evidence does not support; the message says why and what evidence is missing."""


def extra(module: str, what: str, name: str) -> Any:
    """Import a package of an optional extra; `MissingExtraError` says what needs it, and how it is installed."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise MissingExtraError(f"{what} needs {module} ({error}): pip install 'tactune[{name}]'") from error
    except (ImportError, OSError) as error:
        remedy = f"install the system library that is missing, or pip install --force-reinstall 'tactune[{name}]'"
        raise MissingExtraError(f"{what} needs {module}, which cannot be loaded ({error}): {remedy}") from error


@contextmanager
def closed_on_error(close: Callable[[], object]) -> Iterator[None]:
    """Close what is open so far if the block raises."""
    try:
        yield
    except BaseException:
        close()
        raise


@contextmanager
def writing(target: Path | str) -> Iterator[None]:
    """Say which file the operating system refuses to write, and why: an `ExportError`."""
    try:
        yield
    except OSError as error:
        raise ExportError(f"cannot write {target}: {error.strerror or error}; choose another place") from error


def printable(text: str) -> str:
    """Return a text whose control characters, with which a name could act on a terminal, are question marks."""
    return "".join(letter if letter.isprintable() or letter == "\n" else "?" for letter in text)


def foreign(text: object, limit: int = 200) -> str:
    """Return what a file or a library says as one short printable line."""
    line = " ".join(printable(str(text).replace("\n", " ")).split())
    return line if len(line) <= limit else line[: limit - 1] + "…"


def as_sentence(clause: str) -> str:
    """Return a clause, such as an error's message, with a capital letter and a full stop."""
    return f"{clause[:1].upper()}{clause[1:].rstrip('.')}."


def counted(number: int, thing: str) -> str:
    """Return a number with its noun, such as ``"1 frame"`` or ``"2,000 frames"``."""
    plural = "" if number == 1 else "es" if thing.endswith("s") else "s"
    return f"{number:,} {thing}{plural}"


def minus(number: str) -> str:
    """Return the text of a number with a minus sign, as people read it; files and entries keep the hyphen."""
    return number.replace("-", "−")
