"""A sweep in a file: the same as the options of ``tactune sweep``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..model.files import refuse_devices
from .values import SweepError


class SweepFile(BaseModel):
    """What may stand in a sweep file; what is left out is as without the option.

    Attributes
    ----------
    preset : str or None
        A file, from the sweep file's own folder, or a shipped name.
    source, method : list of str
    set : dict
        Field and its values: a list, or a text such as ``"0.005:0.03:6log"``.
    frames : str or int or None
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    preset: str | None = None
    source: list[str] = []
    set: dict[str, Any] = {}
    method: list[str] = []
    frames: str | int | None = None
    seeds: Annotated[int, Field(ge=1, le=1000)] | None = None
    sample: Annotated[int, Field(ge=1)] | None = None
    seed: Annotated[int, Field(ge=0)] | None = None
    objective: str | None = None


def load_sweep_file(path: Path) -> SweepFile:
    """Read a sweep file.

    Raises
    ------
    SweepError
        It cannot be read, is no JSON object, or has a field that is unknown or of the wrong kind.
    """
    refuse_devices(path, SweepError)
    try:
        return SweepFile.model_validate_json(path.read_text("utf-8"))
    except OSError as error:
        raise SweepError(f"cannot read {path}: {error.strerror or error}; check the path") from error
    except UnicodeDecodeError as error:
        raise SweepError(f"{path} is no sweep: it is not a text file; write it as JSON") from error
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"])) or "it"
        known = ", ".join(SweepFile.model_fields)
        raise SweepError(f"{path}: {place}: {first['msg']}; a sweep has the fields {known}") from error
