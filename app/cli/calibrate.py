"""The commands ``tactune calibrate``, ``tactune recheck`` and ``tactune preset create-rig``."""

from __future__ import annotations

import json
import re
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ...core.errors import CalibrationError, FrameError
from .common import (
    UntouchedSource,
    average_frames,
    find_rig,
    open_with_progress,
    warn,
)

if TYPE_CHECKING:
    from ...core.model.intrinsics import Intrinsics

#: Exit status of ``recheck`` after a drift.
DRIFTED_STATUS = 1
_LENS_HELP = (
    "Model and lens of the {} camera: MODEL (L515, D405 or D435) for the maker's values, MODEL=fx,fy,cx,cy in px, "
    "MODEL=camera for that of the connected camera, MODEL=DIR for a folder of pictures of a chessboard."
)


def calibrate(
    *,
    points: Annotated[
        Path, typer.Option("--points", metavar="FILE", help="Clicked pairs: CSV as the wizard exports it.")
    ],
    rig: Annotated[
        str, typer.Option("--rig", metavar="FILE|SOURCE", help="A rig.json, a preset that has a rig, or a source.")
    ],
    model: Annotated[
        Literal["auto", "homography", "rigid"], typer.Option(help="auto: fit both and take the better one.")
    ] = "auto",
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")] = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="PRESET", help="Write the alignment into this preset, new or existing."),
    ] = None,
) -> None:
    """Fit the alignment to clicked points and report its quality."""
    from ...core.calibration import calibrate as fit
    from ...core.calibration import read_points
    from ...core.preset import Preset
    from ...core.preset.file import save_preset
    from ...core.sources.presets import load_preset

    pairs = read_points(points)
    cameras = find_rig(rig)
    base = None
    if out is not None:
        base = load_preset(out) if out.exists() else Preset().with_value("name", out.stem)
    report = fit(pairs, cameras, model)
    if out is not None and base is not None:
        save_preset(report.apply_to(base), out)
    if as_json:
        typer.echo(json.dumps(report.to_json(), indent=2, allow_nan=False))
    else:
        typer.echo(report.words() + ("" if out is None else f"\nwrote {out}"))


def recheck(
    *,
    source: UntouchedSource,
    preset: Annotated[str, typer.Option("--preset", "-p", metavar="FILE|NAME", help="The preset to check.")],
) -> None:
    """Check whether the cameras have moved or the membrane's inflation has changed since the preset was made.

    The alignment is compared with both colour images, the membrane with the preset's untouched frame. Exit status 0
    if every check that could be made passes, 1 after a drift, 2 if nothing could be checked or the untouched frame that
    the preset names is missing. A warning names each check that could not be made. The simulator removes its object for
    this.
    """
    from ...core.calibration.recheck import recheck as recheck_alignment
    from ...core.rig.drift import compare_with_untouched
    from ...core.rig.untouched import load_untouched
    from ...core.sources.presets import load_preset

    checked = load_preset(preset)
    untouched = None if checked.untouched is None else load_untouched(checked.untouched, Path(preset))
    with open_with_progress(source, checked) as opened:
        now, rig = average_frames(opened).frame, opened.rig
    found: dict[str, bool] = {}  # whether all is well, by the sentence that says so
    try:
        drift = recheck_alignment(checked, rig, now)
        found[drift.sentence] = not drift.recalibrate
    except CalibrationError as error:
        warn(f"the alignment was not checked: {error}")
    if untouched is None:
        warn(f"the membrane was not checked: {preset} has no untouched frame; see tactune preset capture-untouched")
    else:
        try:
            membrane = compare_with_untouched(checked, rig, now, untouched)
            found[membrane.sentence] = membrane.verdict == "fine"
        except (CalibrationError, FrameError) as error:
            warn(f"the membrane was not checked: {error}")
    if not found:
        raise CalibrationError(f"nothing of {preset} could be checked on {opened.name}; see the warnings above")
    typer.echo("\n".join(found))
    if not all(found.values()):
        raise typer.Exit(DRIFTED_STATUS)


def create_rig(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="PNG images: one frame, or numbered subfolders.")],
    *,
    proximity: Annotated[str, typer.Option(metavar="LENS", help=_LENS_HELP.format("proximity"))] = "L515",
    tactile: Annotated[str, typer.Option(metavar="LENS", help=_LENS_HELP.format("tactile"))] = "D405",
    corners: Annotated[str, typer.Option(metavar="CxR", help="Inner corners of the chessboard.")] = "9x6",
) -> None:
    """Write the rig.json of a folder of images. The pose of the cameras is a matter of tactune calibrate.

    Colour images of another size than the depth images get the lens that the connected camera states if --proximity
    says =camera, else the maker's.
    """
    from ...core.calibration.lens import make_rig
    from ...core.sources.folder import first_image_sizes, write_rig

    sizes = {name: (width, height) for name, (height, width) in first_image_sizes(folder).items()}
    board = re.fullmatch(r"(\d+)x(\d+)", corners)
    if board is None:
        raise typer.BadParameter(f"--corners is {corners!r}; write the inner corners as 9x6")
    size = int(board[1]), int(board[2])
    cameras = {
        role: _camera(text, "depth", sizes[f"{role}_depth.png"], size)
        for role, text in (("proximity", proximity), ("tactile", tactile))
    }
    if sizes["proximity_color.png"] != sizes["proximity_depth.png"]:
        model, _, how = proximity.partition("=")
        lens = _camera(proximity if how == "camera" else model, "colour", sizes["proximity_color.png"], size)
        cameras["proximity_color"] = {key: lens[key] for key in lens if key not in ("model", "depth_unit_m")}
    write_rig(folder, make_rig(cameras))
    typer.echo(f"wrote {folder / 'rig.json'}")


def _camera(text: str, kind: str, size: tuple[int, int], corners: tuple[int, int]) -> dict[str, Any]:
    """Return a camera as ``rig.json`` has it, from an option such as ``D405=boards``."""
    from ...core.calibration.lens import MODELS, fit_lens, nominal_lens

    name, _, how = text.partition("=")
    if name not in MODELS:
        raise typer.BadParameter(f"{text!r}: choose one of {', '.join(MODELS)}, or write rig.json by hand")
    unit_m = MODELS[name].depth_unit_m
    if not how:
        lens = nominal_lens(*size, MODELS[name].views_deg[kind])
        warn(
            f"the {kind} lens of the {name} is the maker's, not measured: positions to the side are wrong by a few per "
            f"cent; give {name}=camera, or {name}=DIR with pictures of a chessboard"
        )
    elif how == "camera":
        lens, unit_m = _connected(name, kind, size)
    elif how.count(",") == 3:
        try:
            numbers = dict(zip(("fx", "fy", "cx", "cy"), map(float, how.split(",")), strict=True))
        except ValueError as error:
            raise typer.BadParameter(f"{text!r}: write four numbers, fx,fy,cx,cy in px") from error
        return {"model": name, "depth_unit_m": unit_m, "width": size[0], "height": size[1], **numbers}
    else:
        fit = fit_lens(Path(how), *corners, size)
        rejected = f"; rejected: {', '.join(fit.refused)}" if fit.refused else ""
        warn(f"{how}: {fit.used} pictures, {fit.rms_px:.2f} px RMS, fx ± {fit.focal_sd_px:.1f} px{rejected}")
        lens = fit.intrinsics
    return {"model": name, "depth_unit_m": unit_m, **lens.model_dump(mode="json")}


def _connected(model: str, kind: str, size: tuple[int, int]) -> tuple[Intrinsics, float]:
    """Return the lens that a connected camera states for its images, and its depth unit in metres."""
    from ...core.sources.cameras.drivers import camera_drivers, connected_devices

    for driver, device in connected_devices(camera_drivers()[0])[0]:
        if model in device.model:
            with closing(driver.open(device.serial, device.role or "proximity")) as camera:
                lens = camera.calibration.depth.intrinsics if kind == "depth" else camera.calibration.color
            if lens is not None and (lens.width, lens.height) == size:
                return lens, camera.calibration.depth.depth_unit_m
    raise CalibrationError(
        f"no connected {model} states a {kind} lens for {size[0]} x {size[1]} pixels; tactune devices"
    )
