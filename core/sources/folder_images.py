"""Images of folders, brought to the counts and pixels of a rig: depth of any usual form, colour, lenses of others.

A camera in the ``rig.json`` of a folder may have two fields that other recordings do not need: ``rectify`` (``model``
and ``coefficients`` of a lens model that `Intrinsics` lacks; images are rectified when they are read), and
``value_m``, metres that a floating-point value stands for.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..errors import SourceError
from ..model.arrays import AnyArray, Uint8Array, Uint16Array
from ..model.files import atomic_path
from ..model.frames import DepthCamera, Rig
from ..model.intrinsics import Intrinsics
from ..model.loading import decode_image, parse_npy, read_file
from ..model.rig_file import json_text, parse_rig, read_json_object, rig_to_json, validation_sentence
from .lens import Lens, make_lens

CAMERAS: Final = ("proximity", "tactile", "proximity_color")
_STRICT: Final = ConfigDict(frozen=True, strict=True, extra="forbid", allow_inf_nan=False)


class Rectify(BaseModel):
    """A lens model beyond Brown-Conrady, as `make_lens` takes it."""

    model_config = _STRICT

    model: str
    coefficients: Annotated[list[float], Field(max_length=14)]


class Form(BaseModel):
    """What `Rig` does not say about the images of one camera of a folder."""

    model_config = _STRICT

    rectify: Rectify | None = None
    value_m: Annotated[float, Field(gt=0.0, le=1.0)] = 1.0


@dataclass(frozen=True, eq=False)
class CameraForm:
    """How values become counts, and where pixels go."""

    value_m: float = 1.0
    lens: Lens | None = None

    def rectified(self, image: AnyArray) -> AnyArray:
        return image if self.lens is None else self.lens.rectify(image)


def load_folder_rig(path: Path) -> tuple[Rig, dict[str, CameraForm]]:
    """Return the rig of a folder and the forms of its images, by the names in `CAMERAS`; errors as of `load_rig`."""
    data = read_json_object(path)
    stated: dict[str, Form] = {}
    for name in CAMERAS:
        if isinstance(camera := data.get(name), dict):
            fields = {key: camera[key] for key in Form.model_fields if key in camera}
            try:
                stated[name] = Form.model_validate(fields)
            except ValidationError as error:
                raise SourceError(validation_sentence(error, f"{path}: {name}", "a camera")) from error
    rig = parse_rig(data, str(path))
    alone = stated.get("tactile", Form())
    stated.setdefault("proximity", alone)  # of a rig with a tactile camera only
    stated.setdefault("proximity_color", stated["proximity"])  # aligned colour has the lens of the depth
    lenses = {
        "proximity": rig.proximity.intrinsics,
        "tactile": rig.tactile.intrinsics,
        "proximity_color": (rig.proximity_color or rig.proximity).intrinsics,
    }
    return rig, {name: CameraForm(stated[name].value_m, _lens(lenses[name], stated[name])) for name in CAMERAS}


def _lens(intrinsics: Intrinsics, form: Form) -> Lens | None:
    if form.rectify is None:
        return None
    matrix = intrinsics.camera_matrix().ravel().tolist()
    return make_lens(form.rectify.model, form.rectify.coefficients, matrix, (intrinsics.width, intrinsics.height))


def write_rig(path: Path, rig: Rig, forms: dict[str, dict[str, Any]] | None = None) -> None:
    """Write ``rig.json`` with the cameras' ``forms`` into a folder, whole or not at all; one that is there stays."""
    data = rig_to_json(rig)
    for name, fields in (forms or {}).items():
        data[name] |= fields
    with atomic_path(path / "rig.json", exclusive=True) as temporary:
        temporary.write_text(json_text(data), encoding="utf-8")


def read_depth(path: Path, camera: DepthCamera, form: CameraForm | None = None) -> Uint16Array:
    """Return the counts of a depth image, uint16 (H, W), in the camera's unit; 0 is no depth."""
    form = form or CameraForm()
    image = check_size(path, read_values(path), camera.intrinsics.shape)
    if image.dtype.kind == "f":
        with np.errstate(invalid="ignore", over="ignore"):
            counts = image * (form.value_m / camera.depth_unit_m)
            known = (counts > 0) & (counts < np.iinfo(np.uint16).max)
        image = np.rint(np.where(known, counts, 0)).astype(np.uint16)
    return np.asarray(form.rectified(image), np.uint16)


def read_values(path: Path) -> AnyArray:
    """Return a depth image as its file has it: uint16 counts or floating-point values, shape (H, W)."""
    image = read_image(path)
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.dtype.kind in "iu" and image.dtype.itemsize > 1 and image.ndim == 2:
        if image.dtype != np.uint16 and image.size and (image.min() < 0 or image.max() > np.iinfo(np.uint16).max):
            raise SourceError(f"{path} has counts from {image.min()} to {image.max()}; save them as uint16")
        return image.astype(np.uint16)
    if image.dtype.kind == "f" and image.ndim == 2:
        return image.astype(np.float64)
    found = image.shape[2] if image.ndim == 3 else 1
    what = (
        f"the shape {image.shape}"
        if image.ndim not in (2, 3)
        else f"{found} channels of {8 * image.dtype.itemsize} bits"
    )
    raise SourceError(
        f"{path} has {what}, but 1 of 16 bits or of floating-point values are needed; save the depth itself, not a "
        "picture of it"
    )


def read_color(path: Path, shape: tuple[int, int], form: CameraForm | None = None) -> Uint8Array:
    """Return a colour image, RGB uint8 (H, W, 3); grey becomes colour, transparency and the lower 8 of 16 bits go."""
    image = check_size(path, read_image(path), shape)
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    channels = image.shape[2] if image.ndim == 3 else 1
    if image.dtype != np.uint8 or channels not in _TO_RGB or path.suffix.lower() == ".npy":
        raise SourceError(
            f"{path} has {channels} channels of {image.dtype.itemsize * 8} bits, but colour is a PNG or JPEG of 8 bits "
            "with 1, 3 or 4 channels; save it in that form"
        )
    rgb = np.asarray(cv2.cvtColor(image, _TO_RGB[channels]), np.uint8)
    return np.ascontiguousarray((form or CameraForm()).rectified(rgb))


_TO_RGB: Final = {1: cv2.COLOR_GRAY2RGB, 3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGB}


def read_image(path: Path) -> AnyArray:
    """Return an image or a ``.npy`` as it is; `SourceError` if it cannot be read."""
    is_array = path.suffix.lower() == ".npy"
    try:
        return parse_npy(read_file(path)) if is_array else decode_image(read_file(path))
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror or error}; export or copy it again") from error
    except ValueError as error:
        what = "NumPy array" if is_array else f"{path.suffix[1:].upper()} image"
        raise SourceError(f"{path} is no readable {what} ({error}); export or copy it again") from error


def check_size(path: Path, image: AnyArray, shape: tuple[int, int]) -> AnyArray:
    """Return an image of this height and width; `SourceError` for another size."""
    if image.shape[:2] != shape:
        found = " x ".join(map(str, image.shape[1::-1])) if image.ndim in (2, 3) else str(image.shape)
        raise SourceError(
            f"{path} is {found} pixels, but rig.json says {shape[1]} x {shape[0]}; use the rig of the camera that took "
            "it"
        )
    return image
