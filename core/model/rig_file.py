"""The rig as a JSON file, beside the frames of a recording: one flat object per camera.

::

    {
      "proximity": {"model": …, "serial": …, "width": …, "height": …, "fx": …, "fy": …, "cx": …, "cy": …,
                    "distortion": "none", "coefficients": [k1, k2, p1, p2, k3], "depth_unit_m": …},
      "tactile": {the same fields},
      "proximity_color": {the lens fields, "T_color_depth": 4 x 4},
      "T_proximity_tactile": 4 x 4
    }

``model``, ``serial``, ``distortion``, ``coefficients``, ``proximity_color`` and ``T_proximity_tactile`` are optional.
A rig with a tactile camera only has neither ``proximity`` nor a pose.
"""

from __future__ import annotations

import json
import reprlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ..errors import SourceError, TactuneError, foreign
from .frames import DepthCamera, Rig
from .intrinsics import Intrinsics
from .loading import read_json

_LENS_FIELDS = tuple(Intrinsics.model_fields)
#: Fields that only the images of a folder need (see `tactune.core.sources.folder`).
_FOLDER_FIELDS = ("rectify", "value_m")


def load_rig(path: Path | str) -> Rig:
    """Read a rig file; `SourceError` names the file, and a field that is missing, unknown or out of range."""
    return parse_rig(read_json_object(Path(path)), str(path))


def json_text(data: dict[str, Any]) -> str:
    """Return JSON text; floats are exact."""
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def read_json_object(path: Path) -> dict[str, Any]:
    """Read a file that contains one JSON object; `SourceError` names the file and the error."""
    try:
        data = read_json(path)
    except FileNotFoundError as error:
        raise SourceError(
            f"there is no file {path}, which describes both cameras; tactune preset create-rig writes one"
        ) from error
    except OSError as error:
        remedy = "check its permissions" if error.errno else "choose another"  # no number: a pipe or a device
        raise SourceError(f"cannot read {path}: {error.strerror or error}; {remedy}") from error
    except ValueError as error:
        raise SourceError(f"{path} cannot be used: {error}; correct it or write it again") from error
    if not isinstance(data, dict):
        raise SourceError(f"{path} holds a {type(data).__name__}, not a JSON object; wrap its fields in braces")
    return data


def rig_to_json(rig: Rig) -> dict[str, Any]:
    """Return the rig as the JSON object described at the top of this module."""
    if not rig.has_proximity:
        return {"tactile": _depth_json(rig.tactile)}
    data: dict[str, Any] = {"proximity": _depth_json(rig.proximity), "tactile": _depth_json(rig.tactile)}
    if rig.proximity_color is not None:
        pose = [list(row) for row in rig.proximity_color.T_color_depth]
        data["proximity_color"] = {**_lens_json(rig.proximity_color.intrinsics), "T_color_depth": pose}
    if rig.T_proximity_tactile is not None:
        data["T_proximity_tactile"] = [list(row) for row in rig.T_proximity_tactile]
    return data


def parse_rig(data: dict[str, Any], origin: str) -> Rig:
    """Return the rig of a decoded JSON object, as at the top of this module; ``origin`` names it in a `SourceError`."""
    nested = dict(data)
    for key in ("proximity", "tactile", "proximity_color"):
        if isinstance(nested.get(key), dict):
            flat = nested[key].items()
            lens = {name: value for name, value in flat if name in _LENS_FIELDS}
            rest = {name: value for name, value in flat if name not in (*_LENS_FIELDS, *_FOLDER_FIELDS)}
            nested[key] = {**rest, "intrinsics": lens} if "intrinsics" not in rest else rest
    with validating(origin, "a rig"):
        if nested.keys() == {"tactile"}:
            camera = DepthCamera.model_validate_json(json.dumps(nested["tactile"]), strict=True)
            return Rig.of_one_camera(camera)
        return Rig.model_validate_json(json.dumps(nested), strict=True)


def _depth_json(camera: DepthCamera) -> dict[str, Any]:
    serial = {"serial": camera.serial} if camera.serial else {}
    return {"model": camera.model, **serial, **_lens_json(camera.intrinsics), "depth_unit_m": camera.depth_unit_m}


def _lens_json(intrinsics: Intrinsics) -> dict[str, Any]:
    data = intrinsics.model_dump(mode="json")
    if not any(intrinsics.coefficients):
        del data["coefficients"]
    return data


@contextmanager
def validating(origin: str, what: str, kind: type[TactuneError] = SourceError) -> Iterator[None]:
    """Say the first of pydantic's errors in words, with the path of the field as in the file; ``what`` has them."""
    try:
        yield
    except ValidationError as error:
        details = error.errors(include_url=False)
        more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
        raise kind(f"{origin}: {field_sentence(details[0], what)}{more}") from error


def field_sentence(detail: Any, what: str) -> str:
    """Return one of pydantic's errors in words: the path of the field, its value, and what is allowed."""
    where = foreign(".".join(str(part) for part in detail["loc"] if part != "intrinsics"), 120) or what
    if detail["type"] == "missing":
        return f"{where} is missing; add it"
    if detail["type"] == "extra_forbidden":
        return f"{where} is no field of {what}; remove or correct it"
    if detail["type"] == "json_invalid":  # of what Python's parser could read
        return f"{where} holds a text that is no valid Unicode, or is nested too deep; correct it"
    found, why = foreign(reprlib.repr(detail["input"]), 80), detail["msg"].removeprefix("Value error, ")
    why = why.replace("Input should", "it should").replace("a valid boolean", "true or false")
    return f"{where} is {found}: {why}{'' if ';' in why else '; correct it'}"
