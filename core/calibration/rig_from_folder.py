"""The rig of a folder of images: lenses and units from files, the maker or what a person gives; each gap is named."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from ..errors import CalibrationError, SourceError, foreign
from ..model.arrays import AnyArray
from ..model.clouds import valid_depth
from ..model.frames import MAX_UNIT_M, ColorCamera, DepthCamera, Matrix4, Rig
from ..model.intrinsics import Intrinsics
from ..model.loading import decode_image, read_file
from ..model.rig_file import validating
from ..sources.folder import read_image, read_values
from ..sources.folder_layout import Layout, find_frames
from ..sources.lens_files import Lens, StatedLens, choose_lens, find_lens_files, make_lens, pose_between, read_lenses
from ..sources.ros_image import FLOAT_UNIT_M
from .detect import detect_chessboard

#: Where half of the depths of a rig's cameras should lie, metres; makers' models see nothing nearer than they state.
_PLAUSIBLE_M: Final = (0.06, 5.0)
_UNITS: Final = {"m": 1.0, "cm": 0.01, "mm": 0.001, "um": 1e-6}
#: Files that count as pictures.
PICTURE_ENDINGS: Final = (".png", ".jpg", ".jpeg", ".bmp")

_MIN_PICTURES: Final = 4
#: No corner is found more exactly than this, one direction, pixels.
_CORNER_PX: Final = 0.05
#: Largest RMS distance of corners from where the fitted lens expects them, pixels.
_MAX_RMS_PX: Final = 1.5
#: Largest standard deviation of a focal length, as a share of it.
_MAX_FOCAL_SHARE: Final = 0.02
#: Views that depth cameras have: angle over the image's width or height, degrees.
_VIEW_DEG: Final = (10.0, 150.0)


@dataclass(frozen=True)
class CameraModel:
    """What the maker states: length of a count, nearest depth, and fields of view (horizontal, vertical)."""

    depth_unit_m: float
    near_m: float
    views_deg: Mapping[str, tuple[float, float]]


#: Intel's data sheets of the L500 and D400 families.
MODELS: Final = {
    "L515": CameraModel(0.00025, 0.2, {"depth": (70.0, 55.0), "colour": (70.0, 43.0)}),
    "D405": CameraModel(0.0001, 0.06, {"depth": (84.0, 58.0), "colour": (84.0, 58.0)}),
    "D435": CameraModel(0.001, 0.1, {"depth": (87.0, 58.0), "colour": (69.0, 42.0)}),
}


@dataclass(frozen=True)
class FolderRig:
    """A rig, what `write_rig` needs beside it, what was found where, and what is missing or assumed."""

    rig: Rig
    forms: dict[str, dict[str, Any]]
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


@dataclass
class _Draft:
    layout: Layout
    folder: Path
    corners: tuple[int, int]
    notes: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    #: The lens of each role that a file states, and all lenses of that file.
    stated: dict[str, tuple[StatedLens, list[StatedLens]]] = field(default_factory=dict)

    def said(self, role: str) -> str:
        """Return how a role is called: the only camera, whose files may say anything, is the tactile one."""
        is_only = role == "proximity" and "tactile_depth" not in self.layout.slots
        return "tactile" if is_only else "colour" if role == "color" else role

    def first(self, slot: str) -> Path:
        return next(frame.images[slot] for frame in self.layout.frames if slot in frame.images)


@dataclass(frozen=True)
class _Camera:
    model: str
    lens: Lens
    form: dict[str, Any]
    unit_m: float | None = None


def rig_from_folder(
    folder: Path,
    options: dict[str, str | None],
    unit: str | None = None,
    corners: tuple[int, int] = (9, 6),
) -> FolderRig:
    """Return the rig of a folder of images in any layout that `find_frames` knows.

    ``options`` are ``[MODEL=]LENS`` of ``proximity``, ``tactile`` and ``color``: a file, a folder with pictures of a
    chessboard with these inner ``corners``, ``fx,fy,cx,cy``, or left out for the maker's; None where files
    beside the images state it. ``unit`` is that of a count: ``mm``, metres, ``1/5000``, ``proximity=…,tactile=…``.
    """
    draft = _Draft(find_frames(folder), folder, corners)
    roles = [role for role in ("proximity", "tactile") if f"{role}_depth" in draft.layout.slots]
    units = _units(unit)
    cameras: dict[str, DepthCamera] = {}
    forms: dict[str, dict[str, Any]] = {}
    for role in roles:
        image = read_values(draft.first(f"{role}_depth"))
        option = options.get(role) or (options.get("tactile") if len(roles) == 1 else None)
        found = _camera(draft, role, option, "depth", (image.shape[1], image.shape[0]))
        check_lens(found.lens.intrinsics, f"{draft.said(role)} camera")
        given = units.get(role) or (units.get("tactile") if len(roles) == 1 else None)
        unit_m, value = _unit(draft, role, found, given, image)
        with validating(str(folder), f"the {draft.said(role)} camera"):
            camera = DepthCamera(model=found.model, intrinsics=found.lens.intrinsics, depth_unit_m=unit_m)
        cameras[role], forms[role] = camera, found.form | value
    notes, warnings = draft.notes, draft.warnings
    if len(roles) == 1:
        [role] = roles
        if "proximity_color" not in draft.layout.slots:
            warnings.append("the folder has no colour: its image stays black")
        elif read_image(draft.first("proximity_color")).shape[:2] != cameras[role].intrinsics.shape:
            warnings.append("the colour has another size than the depth, so it is left out")
        elif draft.layout.name not in ("TUM", "BOP"):
            warnings.append("the colour has the size of the depth and is taken as aligned to it")
        return FolderRig(Rig.of_one_camera(cameras[role]), {"tactile": forms[role]}, tuple(notes), tuple(warnings))
    rig = Rig(**cameras)
    if (color := _color(draft, options.get("color"), rig.proximity.intrinsics)) is not None:
        rig, forms["proximity_color"] = rig.model_copy(update={"proximity_color": color[0]}), color[1]
    if "tactile" in draft.stated and draft.stated.get("proximity") == draft.stated["tactile"]:
        path = draft.stated["tactile"][0].path
        warnings.append(f"both cameras have the lens in {path}; give each its own (--proximity, --tactile)")
    if (pose := _stated_pose(draft, "proximity", "tactile")) is None:
        warnings.append("the pose between the cameras is unknown: calibrate the alignment")
    return FolderRig(rig.model_copy(update={"T_proximity_tactile": pose}), forms, tuple(notes), tuple(warnings))


def _color(draft: _Draft, option: str | None, depth: Intrinsics) -> tuple[ColorCamera, dict[str, Any]] | None:
    """Return the colour camera beside the proximity depth; None where colour is taken as aligned, or is left out."""
    if "proximity_color" not in draft.layout.slots:
        draft.warnings.append("the folder has no proximity colour: its image stays black")
        return None
    image = read_image(draft.first("proximity_color"))
    size = image.shape[1], image.shape[0]
    if option is None and size == depth.shape[::-1]:
        if draft.layout.name not in ("TUM", "BOP"):
            draft.warnings.append(
                "the proximity colour has the size of the depth and is taken as aligned to it; if it is not, give the "
                "lens of the colour camera (--color)"
            )
        return None
    found = None if option is None else _camera(draft, "color", option, "colour", size)
    pose = _stated_pose(draft, "colour", "proximity")
    if found is None or pose is None:
        draft.warnings.append(
            "the pose of the colour camera is unknown, so its images are left out; state one camchain as the lens "
            "of both (--color, --proximity), or write proximity_color with T_color_depth into rig.json"
        )
        return None
    check_lens(found.lens.intrinsics, "proximity colour camera")
    return ColorCamera(intrinsics=found.lens.intrinsics, T_color_depth=pose), found.form


def _camera(draft: _Draft, role: str, option: str | None, kind: str, size: tuple[int, int]) -> _Camera:
    """Return the model and the lens that an option says, or files beside the images."""
    said = draft.said(role)
    if option is None:
        found = [] if role == "color" else find_lens_files(draft.folder, role, draft.first(f"{role}_depth"))
        if len(found) != 1:
            several = f": {' and '.join(path.name for path in found[:2])} may state it" if found else ""
            raise CalibrationError(
                f"the lens of the {said} camera is unknown{several}; state it as a file (a camera_info.yaml, Kalibr's "
                f"or OpenCV's file, K.txt), as fx,fy,cx,cy in px, or as {', '.join(MODELS)} for the maker's values "
                f"(--{said})"
            )
        option = str(found[0])
    option = option.removesuffix("=")  # else the lens would be the folder in which the command runs
    if option in MODELS:
        draft.warnings.append(
            f"the {kind} lens of the {option} is the maker's, not measured: positions to the side are wrong by a few "
            f"per cent; give {option}=FILE, or {option}=DIR with pictures of a chessboard"
        )
        return _Camera(option, Lens(nominal_lens(*size, MODELS[option].views_deg[kind])), {})
    model, how = option.split("=", 1) if "=" in option else ("unknown", option)
    if re.fullmatch(r"[^,]*(,[^,]*){3}", how):
        return _Camera(model, _typed(option, how, size), {})
    if Path(how).is_dir():
        fit = fit_lens(Path(how), *draft.corners, size)
        rejected = f"; rejected: {', '.join(fit.refused)}" if fit.refused else ""
        draft.warnings.append(
            f"{how}: {fit.used} pictures, {fit.rms_px:.2f} px RMS, fx and fy ± {fit.focal_sd_px:.1f} px{rejected}"
        )
        return _Camera(model, Lens(fit.intrinsics), {})
    return _of_file(draft, said, model, how, size)


def _of_file(draft: _Draft, role: str, model: str, how: str, size: tuple[int, int]) -> _Camera:
    path, name = Path(how), ""
    if not path.exists() and ":" in how:
        path, name = Path(how.rpartition(":")[0]), how.rpartition(":")[2]
    lenses = read_lenses(path)
    if name:
        matching = [lens for lens in lenses if lens.name.split(" ")[0] == name.lower()]
        if not matching:
            names = ", ".join(lens.name.split(" ")[0] for lens in lenses)
            raise CalibrationError(f"{path} has no camera {foreign(name, 40)!r}; it has {names}")
        chosen = matching[0]
    else:
        chosen = choose_lens(lenses, role, size)
    draft.stated[role] = chosen, lenses
    lens = chosen.lens(size)
    rectify = {"model": chosen.model, "coefficients": list(chosen.coefficients)}
    words = "no distortion"
    if any(chosen.coefficients):
        words = f"{foreign(chosen.model, 40)} with {len(chosen.coefficients)} coefficients"
    draft.notes.append(f"{role}: lens from {path} ({words}, fx {lens.intrinsics.fx:.2f} px)")
    return _Camera(model, lens, {} if lens.table is None else {"rectify": rectify}, chosen.unit_m)


def _typed(option: str, how: str, size: tuple[int, int]) -> Lens:
    try:
        fx, fy, cx, cy = map(float, how.split(","))
    except ValueError as error:
        raise CalibrationError(f"{foreign(option, 80)!r}: write four numbers, fx,fy,cx,cy in px") from error
    try:
        return make_lens("none", (), (fx, 0, cx, 0, fy, cy, 0, 0, 1), size)
    except SourceError as error:
        raise CalibrationError(f"{foreign(option, 80)!r}: {error}") from error


def _units(text: str | None) -> dict[str, float]:
    """Return metres per count of each camera that ``--unit`` names."""
    if text is None:
        return {}
    both = text if "=" in text else f"proximity={text},tactile={text}"
    parts = dict(part.partition("=")[::2] for part in both.split(","))
    units: dict[str, float] = {}
    for role, value in parts.items():
        above, _, below = value.partition("/")
        try:
            unit_m = _UNITS.get(value.strip()) or float(above) / float(below or 1)
        except (ValueError, ZeroDivisionError):
            unit_m = 0.0
        if role.strip() not in ("proximity", "tactile") or not 1e-7 <= unit_m <= 1:
            raise CalibrationError(
                f"the unit (--unit) is {foreign(text, 60)!r}; write mm, metres per count such as 0.00025 "
                "or 1/5000, or one for each camera, as in proximity=mm,tactile=0.0001"
            )
        units[role.strip()] = unit_m
    return units


def _unit(
    draft: _Draft, role: str, camera: _Camera, given_m: float | None, image: AnyArray
) -> tuple[float, dict[str, float]]:
    """Return the length of a count and, for floating-point images, what a value stands for; say why."""
    said, is_float = draft.said(role), image.dtype.kind == "f"
    counts_per_m = draft.layout.counts_per_m
    assumed = False
    if given_m is not None:
        unit_m, why = given_m, "given"
    elif camera.unit_m is not None:
        unit_m, why = camera.unit_m, "stated with the lens"
    elif is_float:
        unit_m, why = 1.0, "floating-point values count as metres"
    elif counts_per_m is not None:
        unit_m, why = 1 / counts_per_m, f"{draft.layout.name}'s {counts_per_m:.0f} counts a metre"
    elif camera.model in MODELS:
        unit_m, why, assumed = MODELS[camera.model].depth_unit_m, f"that of the {camera.model}", True
    else:
        raise CalibrationError(
            f"the unit of the {said} depth is unknown: {draft.first(f'{role}_depth').name} holds counts; state it "
            f"as mm, or as metres per count such as {said}=0.00025 (--unit)"
        )
    if not is_float and unit_m > MAX_UNIT_M:
        raise CalibrationError(
            f"the unit says {unit_m:g} m for {said}; a count is at most {MAX_UNIT_M * 1e3:g} mm, such as mm (--unit)"
        )
    known = (image > 0) if is_float else valid_depth(image)
    half_m = float(np.median(image[known])) * unit_m if known.any() else float("nan")
    draft.notes.append(f"{said}: depth unit {unit_m * 1e3:g} mm ({why}); half of the depths are below {half_m:.3f} m")
    near_m = MODELS[camera.model].near_m if camera.model in MODELS else _PLAUSIBLE_M[0]
    is_plausible = near_m <= half_m <= _PLAUSIBLE_M[1]
    doubt = f"half of the {said} depths are below {half_m:.3g} m; {near_m:g} to {_PLAUSIBLE_M[1]:g} m are plausible"
    if assumed and known.any() and not is_plausible:
        raise CalibrationError(
            f"the unit of the {said} depth is unknown: with the {unit_m * 1e3:g} mm that a {camera.model} sends, "
            f"{doubt}; state it, such as mm (--unit)"
        )
    if assumed:
        draft.warnings.append(
            f"the unit of the {said} depth is assumed: a {camera.model} sends {unit_m * 1e3:g} mm, and a program that "
            "saved the images may have converted it; state it, such as mm (--unit)"
        )
    elif not is_plausible:
        draft.warnings.append(f"the unit of the {said} depth is implausible: {doubt}; check it (--unit)")
    return (FLOAT_UNIT_M, {} if unit_m == 1 else {"value_m": unit_m}) if is_float else (unit_m, {})


def _stated_pose(draft: _Draft, first: str, second: str) -> Matrix4 | None:
    """Return ``T_first_second`` if one file states both cameras and their pose."""
    if first not in draft.stated or second not in draft.stated:
        return None
    (one, lenses), (other, others) = draft.stated[first], draft.stated[second]
    pose = pose_between(one, other, lenses) if lenses == others else None
    if pose is not None:
        draft.notes.append(f"pose of {first} and {second} from {one.path}")
    return pose


# A lens as its maker states it, or from pictures of a chessboard


def nominal_lens(width: int, height: int, view_deg: tuple[float, float]) -> Intrinsics:
    """Return the lens that a field of view means: centred, square pixels, no distortion.

    The image is the sensor's, scaled, and cropped on two sides if its shape differs; so the larger of the two focal
    lengths holds.
    """
    across, down = (math.tan(math.radians(angle) / 2) for angle in view_deg)
    focal = max(width / 2 / across, height / 2 / down)
    return Intrinsics(width=width, height=height, fx=focal, fy=focal, cx=(width - 1) / 2, cy=(height - 1) / 2)


def check_lens(lens: Intrinsics, camera: str) -> None:
    """Raise `CalibrationError` if no depth camera has such a lens; ``camera`` names it in the message."""
    low, high = _VIEW_DEG
    for axis, focal, extent in (("fx", lens.fx, lens.width), ("fy", lens.fy, lens.height)):
        view = 2 * math.degrees(math.atan(extent / 2 / focal))
        if not low <= view <= high:
            raise CalibrationError(
                f"{camera}: {axis} is {focal:.6g} px, a view of {view:.0f} degrees over {extent} px, "
                f"but depth cameras have {low:.0f} to {high:.0f}; correct it"
            )


@dataclass(frozen=True)
class LensFit:
    """A lens fitted to pictures of a chessboard, with Brown-Conrady distortion.

    ``rms_px`` is the RMS distance of the corners from where the lens expects them, ``focal_sd_px`` the larger standard
    deviation of fx and fy, ``used`` the number of pictures with a whole board; ``refused`` says by file name why others
    were rejected.
    """

    intrinsics: Intrinsics
    rms_px: float
    focal_sd_px: float
    used: int
    refused: Mapping[str, str]


def fit_lens(folder: Path, columns: int, rows: int, size: tuple[int, int] | None = None) -> LensFit:
    """Fit a lens to the pictures of a chessboard in a folder (Zhang's method, OpenCV's ``calibrateCamera``).

    The board has ``columns`` x ``rows`` inner corners, is whole and at different tilts; the size of its squares does
    not matter. ``size`` is the width and height that the pictures must have. k3 is left at 0: few pictures do not
    determine it.
    """
    try:
        paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in PICTURE_ENDINGS)
    except OSError as error:
        raise CalibrationError(f"cannot list {folder}: {error.strerror or error}; choose another folder") from error
    found: list[AnyArray] = []
    refused: dict[str, str] = {}
    for path in paths:
        try:
            picture = decode_image(read_file(path), gray=True)
            height, width = picture.shape[:2]
            size = size or (width, height)
            if (width, height) != size:
                raise CalibrationError(f"it has {width} x {height} pixels, but {size[0]} x {size[1]} are needed")
            found.append(detect_chessboard(picture, columns, rows).astype(np.float32))
        except (OSError, ValueError, CalibrationError) as error:
            refused[path.name] = str(error)
    if len(found) < _MIN_PICTURES or size is None:
        why = "".join(f" ({name}: {sentence})" for name, sentence in list(refused.items())[:1])
        raise CalibrationError(
            f"{folder}: a whole chessboard of {columns} x {rows} inner corners is in {len(found)} of {len(paths)} "
            f"pictures, but {_MIN_PICTURES} are needed{why}"
        )
    board = np.zeros((columns * rows, 3), np.float32)
    board[:, :2] = np.mgrid[:columns, :rows].T.reshape(-1, 2)
    guess = np.array([[size[0], 0, (size[0] - 1) / 2], [0, size[0], (size[1] - 1) / 2], [0, 0, 1]], np.float64)
    rms, K, distortion, turns, shifts = cv2.calibrateCamera(
        [board] * len(found), found, size, guess, np.zeros(5), flags=cv2.CALIB_FIX_K3 | cv2.CALIB_USE_INTRINSIC_GUESS
    )
    focal_px = float(min(K[0, 0], K[1, 1]))
    jacobians = [cv2.projectPoints(board, *pose, K, distortion)[1] for pose in zip(turns, shifts, strict=True)]
    focal_sd_px = _focal_sd(jacobians, max(rms / math.sqrt(2), _CORNER_PX))
    if not (rms <= _MAX_RMS_PX and focal_px > 0):
        raise CalibrationError(
            f"{folder}: the corners miss the fitted lens by {rms:.1f} px (RMS); check that the board is flat and that "
            "one camera took all pictures"
        )
    uncertain = min(focal_sd_px / focal_px, 1.0)
    if not uncertain <= _MAX_FOCAL_SHARE:
        raise CalibrationError(
            f"{folder}: fx is uncertain by {uncertain:.0%}; tilt the board by 20 degrees or more, each time another way"
        )
    lens = make_lens("plumb_bob", distortion.ravel()[:5].tolist(), K.ravel().tolist(), size).intrinsics
    check_lens(lens, str(folder))
    return LensFit(lens, float(rms), focal_sd_px, len(found), refused)


def _focal_sd(jacobians: Sequence[AnyArray], noise_px: float) -> float:
    """Return the larger standard deviation of fx and fy, pixels; corners have ``noise_px`` in one direction.

    They are the least squares' own, with the poses of the boards projected out. OpenCV's deviations
    are small where parameters cannot be told apart, since it inverts without those directions. Columns of
    ``jacobians``, (2 N, 15), one for each picture: turn, shift, fx, fy, cx, cy, k1, k2, p1, p2 and k3, which is fixed.
    """
    rows = []
    for jacobian in jacobians:
        pose, lens = np.linalg.qr(jacobian[:, :6])[0], jacobian[:, 6:14]
        rows.append(lens - pose @ (pose.T @ lens))
    _, lengths, directions = np.linalg.svd(np.concatenate(rows), full_matrices=False)
    variances = (directions[:, :2] / np.maximum(lengths, 1e-12)[:, None]) ** 2
    return float(noise_px * np.sqrt(variances.sum(axis=0).max()))
