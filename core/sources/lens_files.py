"""Lenses as files and messages of other programs state them, brought to the pinhole cameras of `Intrinsics`.

Plumb bob is librealsense's Brown-Conrady model. Images of lenses beyond it (rational, thin prism, fisheye) are
rectified when they are read: each becomes the image of a lens without distortion and with the same camera matrix.

Files are those of ROS (``camera_info``, or an echoed message), Kalibr's camchains, OpenCV's YAML, XML and JSON, BOP's
``scene_camera.json``, JSON or YAML with ``fx, fy, cx, cy``, and text with the matrix K or with these four numbers.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

import cv2
import numpy as np
from ruamel.yaml import YAML

from ..errors import SourceError, foreign
from ..model.arrays import AnyArray, Float32Array, Float64Array
from ..model.frames import Matrix4, camera_pose
from ..model.intrinsics import Distortion, Intrinsics
from ..model.loading import parse_json, read_file
from ..model.rig_file import validating
from .ros_image import damage_told

#: Names of lens models, as ROS, image_pipeline, Kalibr, OpenCV and camera makers write them.
_PINHOLE = (
    "plumb_bob",
    "radtan",
    "brown_conrady",
    "pinhole",
    "opencv",
    "rational_polynomial",
    "rational",
    "thin_prism",
    "rational_thin_prism",
    "thin_prism_tilt",
    "tilted",
)
_FISHEYE = ("equidistant", "fisheye", "equi", "kannala_brandt", "kannala_brandt4", "opencv_fisheye", "theta")
_NO_DISTORTION = ("", "none", "no", "null", "perfect", "rectified", "ideal")
#: Files beside images that state their lens, the first that exists.
_LENS_FILES: Final = (
    *("scene_camera.json", "camera_info.y*ml", "camera.json", "*intrinsic*.json", "K.txt", "*intrinsic*.txt"),
    *("*intrinsic*.y*ml", "*camchain*.y*ml", "*calib*.y*ml", "*calib*.json", "*calib*.xml", "ost.yaml"),
)
#: OpenCV's numbers of coefficients of a pinhole lens.
_COUNTS = (4, 5, 8, 12, 14)


@dataclass(frozen=True, eq=False)
class Lens:
    """A lens without or with Brown-Conrady's distortion; ``table`` (H, W, 2) of column, row rectifies other models."""

    intrinsics: Intrinsics
    table: Float32Array | None = None

    def rectify(self, image: AnyArray) -> AnyArray:
        """Return an image without the distortion that `intrinsics` lacks; depth keeps its values, 0 outside."""
        if self.table is None:
            return image
        how = cv2.INTER_NEAREST if image.ndim == 2 else cv2.INTER_LINEAR
        return np.asarray(cv2.remap(image, self.table[..., 0], self.table[..., 1], how))


def make_lens(model: str, coefficients: Sequence[float], camera_matrix: Sequence[float], size: tuple[int, int]) -> Lens:
    """Return a lens of K row by row (9 numbers) and a size (width, height), pixels.

    ``model`` is a distortion model as ROS, Kalibr or OpenCV spell it; ``coefficients`` are in OpenCV's order: k1,
    k2, p1, p2, k3 to k6, s1 to s4, tx, ty, or k1 to k4 of a fisheye. `SourceError` is a clause for a sentence's end.
    """
    name = model.strip().lower().replace("-", "_").replace(" ", "_")
    d = np.array(coefficients, np.float64)
    k = np.array(camera_matrix, np.float64)
    if k.size != 9 or not np.isfinite(k).all() or not np.isfinite(d).all():
        raise SourceError(f"its lens has numbers that are missing or not finite ({foreign(model, 40)})")
    k = k.reshape(3, 3)
    if abs(k[0, 1]) > 1e-6 * abs(k[0, 0]):
        raise SourceError(f"its K has a skew of {k[0, 1]:g}, which no lens here has")
    (fx, _, cx), (_, fy, cy), _ = k.tolist()
    pinhole = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": size[0], "height": size[1]}
    if name in _FISHEYE:
        if d.size > 4:
            raise SourceError(f"its lens model {name!r} has {d.size} coefficients; 4 are needed")
        d = np.pad(d, (0, 4 - d.size))
        maps = cv2.fisheye.initUndistortRectifyMap(k, d, np.eye(3), k, size, cv2.CV_32FC1)
        return Lens(_intrinsics(pinhole), np.stack(maps, axis=-1))
    if name in _NO_DISTORTION or not d.any():
        if d.any():
            raise SourceError(f"its lens has coefficients, but its model is {model!r}; name the model")
        return Lens(_intrinsics(pinhole))
    if name not in _PINHOLE or d.size not in _COUNTS:
        known = ", ".join(("none", "plumb_bob", "rational_polynomial", "thin_prism", "equidistant"))
        raise SourceError(
            f"its lens model {foreign(model, 40)!r} with {d.size} coefficients is unknown; known are {known}"
        )
    if not d[5:].any():
        brown = tuple(np.pad(d, (0, 5))[:5].tolist())
        return Lens(_intrinsics({**pinhole, "distortion": Distortion.BROWN_CONRADY, "coefficients": brown}))
    maps = cv2.initUndistortRectifyMap(k, d, None, k, size, cv2.CV_32FC1)
    return Lens(_intrinsics(pinhole), np.stack(maps, axis=-1))


def _intrinsics(values: dict[str, Any]) -> Intrinsics:
    with validating("its lens cannot be used", "a lens"):
        return Intrinsics(**values)


def camera_info_lens(message: Any, size: tuple[int, int] | None = None, *, is_rectified: bool = False) -> Lens | None:
    """Return the lens of a ``CameraInfo`` for images of a size, cropped and binned; None if it is not filled in yet.

    K and D describe raw images; those that image_pipeline has rectified have the lens P, and no distortion.
    """
    k, p = _field(message, "k"), np.array(_field(message, "p"), np.float64)
    if not k[0] or not k[4]:  # focal lengths
        return None
    by_p = is_rectified and p.size == 12 and p[0] > 0
    matrix: Float64Array = p.reshape(3, 4)[:, :3].copy() if by_p else np.array(k, np.float64).reshape(3, 3)
    stated = _cut(matrix, (message.width, message.height), vars(message.roi), message.binning_x, message.binning_y)
    if size is not None and stated != size:
        raise SourceError(f"its images have {size[0]} x {size[1]} pixels, its lens {stated[0]} x {stated[1]}")
    model, d = ("none", ()) if by_p else (message.distortion_model, _field(message, "d"))
    return make_lens(model, d, matrix.ravel().tolist(), stated)


def _field(message: Any, name: str) -> Any:
    """Return a field whose name ROS 1 writes with a capital letter."""
    return getattr(message, name) if hasattr(message, name) else getattr(message, name.upper())


#: A lens takes a few hundred bytes; BOP states one for each of some thousand images.
_MAX_BYTES: Final = {".json": 5_000_000}
_MAX_TEXT_BYTES: Final = 200_000
#: Brackets in brackets; YAML takes seconds for thousands of them.
_MAX_NESTING: Final = 50
_MATRIX: Final = ("camera_matrix", "cameramatrix", "intrinsic_matrix", "intrinsics", "cam_k", "k", "m1", "mtx")
_COEFFICIENTS: Final = (
    "distortion_coefficients",
    "distortion_coeffs",
    "distcoeffs",
    "dist_coeffs",
    "coefficients",
    "dist",
    "d",
    "d1",
)
_NUMBER: Final = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")
_Fields = Mapping[str, Any]


@dataclass(frozen=True)
class StatedLens:
    """One camera of a file.

    ``matrix`` is K row by row; ``size`` width and height in pixels, or None where the file does not state them;
    ``unit_m`` the length of a depth count; ``T_this_previous`` the pose of a camchain's camera before this one.
    """

    path: Path
    name: str
    model: str
    coefficients: tuple[float, ...]
    matrix: tuple[float, ...]
    size: tuple[int, int] | None = None
    unit_m: float | None = None
    T_this_previous: Matrix4 | None = None

    def lens(self, size: tuple[int, int]) -> Lens:
        """Return the lens of images of this width and height; `SourceError` if the file is about others."""
        if self.size not in (None, size):
            raise SourceError(
                f"{self.path} describes images of {self.size[0]} x {self.size[1]} pixels, but these have "
                f"{size[0]} x {size[1]}; use the file of the camera that took them"
            )
        try:
            return make_lens(self.model, self.coefficients, self.matrix, size)
        except SourceError as error:
            raise SourceError(f"{self.path}: {error}") from error


def find_lens_files(folder: Path, role: str, image: Path) -> list[Path]:
    """Return the files of the best name in the nearest folder around an image of a camera, up to ``folder``."""
    places = [folder / role, *(folder / inside for inside in image.relative_to(folder).parents)]
    return next((found for place in places for name in _LENS_FILES if (found := sorted(place.glob(name)))), [])


def read_lenses(path: Path) -> list[StatedLens]:
    """Return the cameras of a file, in its order; `SourceError` if it states none."""
    suffix = path.suffix.lower()
    with damage_told(path, "it is no file of a lens"):
        text = read_file(path, _MAX_BYTES.get(suffix, _MAX_TEXT_BYTES)).decode("utf-8-sig")
        lenses = _cameras(path, _parse(text, suffix))
    if not lenses:
        raise SourceError(
            f"{path} states no lens: no camera_matrix, K, intrinsics or fx; known are ROS camera_info, Kalibr's "
            "camchain, OpenCV's YAML and XML, and text with K"
        )
    return lenses


def choose_lens(lenses: Sequence[StatedLens], role: str, size: tuple[int, int]) -> StatedLens:
    """Return the camera of a file that is meant: by its name or topic, else the only one of this image size."""
    words = ("proximity", "color") if role == "colour" else (role, "depth")
    named = [lens for lens in lenses if all(word in lens.name for word in words)]
    named = named or [lens for lens in lenses if words[0] in lens.name]
    fitting = named or [lens for lens in lenses if lens.size in (None, size)] or list(lenses)
    if len(fitting) > 1:
        path, names = lenses[0].path, [foreign(lens.name.split(" ")[0], 40) for lens in lenses[:4]]
        raise SourceError(
            f"{path} has {len(lenses)} cameras ({', '.join(names)}); name the one of {role}, as in {path}:{names[0]}"
        )
    return fitting[0]


def lens_of_file(path: Path, role: str, size: tuple[int, int]) -> Lens:
    """Return the lens that a file states for a camera."""
    return choose_lens(read_lenses(path), role, size).lens(size)


def pose_between(proximity: StatedLens, tactile: StatedLens, lenses: Sequence[StatedLens]) -> Matrix4 | None:
    """Return ``T_proximity_tactile`` of two cameras of one camchain, or None if it does not state it."""
    if proximity not in lenses or tactile not in lenses or proximity == tactile:
        return None
    first, last = sorted((lenses.index(proximity), lenses.index(tactile)))
    pose = np.eye(4)  # of camera ``first`` in the present one
    for lens in lenses[first + 1 : last + 1]:
        if lens.T_this_previous is None:
            return None
        pose = np.array(lens.T_this_previous) @ pose
    return camera_pose(pose if lenses.index(tactile) == first else np.linalg.inv(pose))


def _parse(text: str, suffix: str) -> Any:
    if suffix == ".json":
        return parse_json(text)
    if suffix == ".xml":
        return _of_xml(text)
    if suffix in (".yaml", ".yml"):
        text = re.sub(r"\A%YAML.*\n", "", text)  # OpenCV's first line and its tags are not YAML
        text = re.sub(r"!!opencv-[\w-]+", "", text)
        opened = np.cumsum([{"[": 1, "{": 1, "]": -1, "}": -1}.get(letter, 0) for letter in text])
        if opened.max(initial=0) > _MAX_NESTING:
            raise ValueError(f"it has more than {_MAX_NESTING} brackets in brackets")
        first = re.split(r"(?m)^---.*$", text.removeprefix("---"))[0]
        loaded = YAML(typ="safe", pure=True).load(io.StringIO(first))
        if sum(1 for _ in islice(_values(loaded), len(text))) == len(text) > 0:
            raise ValueError("its aliases stand for more values than it has letters")
        return loaded
    return _of_text(text)


def _values(part: Any) -> Iterator[Any]:
    for each in part.values() if isinstance(part, dict) else part if isinstance(part, list) else ():
        yield each
        yield from _values(each)


def _of_xml(text: str) -> _Fields:
    if "<!" in text.replace("<!--", ""):
        raise ValueError("it declares entities or a document type, which no lens needs")
    fields: dict[str, Any] = {}
    for entry in ElementTree.fromstring(text):  # noqa: S314  # without entities, and of 200 kB, it is harmless
        data = entry.find("data")
        fields[entry.tag] = [float(each) for each in (data.text or "").split()] if data is not None else entry.text
    return fields


def _of_text(text: str) -> _Fields:
    """Return the lens of a text: K, or fx fy cx cy, and perhaps k1 k2 p1 p2 k3 behind these."""
    lines = [re.split(r"#|//", line)[0] for line in text.splitlines()]
    if re.search("[a-df-zA-DF-Z]", "".join(lines)):
        raise ValueError("it has words where numbers of K are expected")
    numbers = [float(each) for each in _NUMBER.findall(" ".join(lines))]
    if len(numbers) == 9 and numbers[6:] == [0, 0, 1]:
        return {"k": numbers}
    if len(numbers) in (4, 8, 9):
        return {"k": numbers[:4], "d": numbers[4:]}
    raise ValueError(f"it has {len(numbers)} numbers; K has 9, and fx fy cx cy are 4")


def _cameras(path: Path, data: Any) -> list[StatedLens]:
    if not isinstance(data, dict):
        raise ValueError(f"it holds a {type(data).__name__}, not names with values")
    inner = {str(name): value for name, value in data.items() if isinstance(value, dict)}
    if inner and all("cam_k" in _lower(value) for value in inner.values()):
        first, *others = (_camera(path, name, value) for name, value in inner.items())
        if first is None or any(
            each is None or (each.matrix, each.unit_m) != (first.matrix, first.unit_m) for each in others
        ):
            raise SourceError(f"{path}: cam_K or depth_scale changes from image to image; a rig has one lens")
        return [first]
    if (one := _camera(path, str(data.get("camera_name") or data.get("name") or path.stem), data)) is not None:
        return [one]
    found = (_camera(path, name, value) for name, value in inner.items())
    return [camera for camera in found if camera is not None]


def _lower(fields: _Fields) -> dict[str, Any]:
    return {str(name).lower(): value for name, value in fields.items()}


def _camera(path: Path, name: str, given: _Fields) -> StatedLens | None:
    """Return the lens of one camera; None if the fields have none."""
    fields = _lower(given)
    matrix = fields if "fx" in fields else next((fields[key] for key in _MATRIX if key in fields), None)
    if matrix is None:
        return None
    family = str(fields.get("camera_model", "pinhole"))  # Kalibr's; others than pinhole give the numbers other meanings
    if family.lower() != "pinhole":
        raise SourceError(f"{path}: {foreign(name, 40)} has the camera model {foreign(family, 40)!r}; known is pinhole")
    coefficients = next((_flat(fields[key]) for key in _COEFFICIENTS if fields.get(key) is not None), ())
    fisheye = str(fields.get("fisheye_model", fields.get("fisheye", 0))).lower() not in ("0", "false", "none")
    model = str(fields.get("distortion_model") or fields.get("distortion") or ("fisheye" if fisheye else "opencv"))
    scale = fields.get("depth_scale") if "cam_k" in fields else None  # BOP's is in mm; others mean other things by it
    label = f"{name} {fields.get('rostopic', '')}".strip().lower()
    whole, size = _whole_matrix(_flat(matrix)), _size(fields)
    cut = _cut(whole, size or (0, 0), fields.get("roi") or {}, fields.get("binning_x"), fields.get("binning_y"))
    turned = fields.get("t_cn_cnm1")
    try:
        pose = None if turned is None else camera_pose(np.array(_flat(turned)).reshape(4, 4))
    except ValueError as error:
        raise SourceError(f"{path}: T_cn_cnm1 of {foreign(name, 40)}: {foreign(error, 120)}") from error
    unit_m = None if scale is None else float(scale) * 1e-3
    return StatedLens(path, label, model, coefficients, tuple(whole.ravel().tolist()), size and cut, unit_m, pose)


def _whole_matrix(numbers: Sequence[float]) -> Float64Array:
    """Return K (3, 3) of 9 numbers, by rows or columns, or of fx, fy, cx, cy."""
    if len(numbers) == 4:
        fx, fy, cx, cy = numbers
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    if len(numbers) != 9:
        raise ValueError(f"a lens has {len(numbers)} numbers; K has 9, and fx fy cx cy are 4")
    matrix = np.array(numbers).reshape(3, 3)
    if matrix[2, :2].any() and not matrix[:2, 2].any():
        matrix = matrix.T  # Open3D's, column by column
    if matrix[1, 0] or matrix[2].tolist() != [0, 0, 1]:
        raise ValueError("its matrix is no K: the last row must be 0 0 1")
    return matrix


def _cut(matrix: Float64Array, size: tuple[int, int], roi: _Fields, binning_x: Any, binning_y: Any) -> tuple[int, int]:
    """Bring K to the images that a camera_info describes: cut to its region, then binned; return their size."""
    across, down = (max(1, int(each or 1)) for each in (binning_x, binning_y))
    matrix[:2, 2] -= int(roi.get("x_offset") or 0), int(roi.get("y_offset") or 0)
    matrix[0] /= across
    matrix[1] /= down
    return int(roi.get("width") or size[0]) // across, int(roi.get("height") or size[1]) // down


def _size(fields: _Fields) -> tuple[int, int] | None:
    for key in ("resolution", "image_size"):
        if key in fields:
            width, height = _flat(fields[key])
            return int(width), int(height)
    for prefix in ("image_", ""):
        if fields.get(f"{prefix}width") and fields.get(f"{prefix}height"):
            return int(fields[f"{prefix}width"]), int(fields[f"{prefix}height"])
    return None


def _flat(value: Any) -> tuple[float, ...]:
    """Return the numbers of a list, of nested lists, or of a matrix with a field ``data``."""
    if isinstance(value, dict):
        fields = _lower(value)
        if "fx" in fields:
            return tuple(float(fields[key]) for key in ("fx", "fy", "cx", "cy"))
        value = fields["data"]
    return tuple(np.array(value, np.float64).ravel().tolist())
