"""The command ``tactune preset create-rig``: the rig of a folder of images."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...core.errors import CalibrationError
from .common import CliProgress, warn

if TYPE_CHECKING:
    from ...core.model.intrinsics import Intrinsics

_HELP = (
    "Model and lens of the {} camera: MODEL (L515, D405 or D435) for the maker's values, MODEL=fx,fy,cx,cy in px, "
    "MODEL=camera for that of the connected camera, MODEL=DIR for a folder of pictures of a chessboard."
)


def create_rig(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="PNG images: one frame, or numbered subfolders.")],
    *,
    proximity: Annotated[str, typer.Option(metavar="LENS", help=_HELP.format("proximity"))] = "L515",
    tactile: Annotated[str, typer.Option(metavar="LENS", help=_HELP.format("tactile"))] = "D405",
    proximity_color: Annotated[
        str | None,
        typer.Option(
            metavar="LENS",
            help="The same of its colour images, where they have another size than the depth images. Default: the "
            "model of --proximity, from the connected camera if --proximity says so, else the maker's values.",
        ),
    ] = None,
    corners: Annotated[str, typer.Option(metavar="CxR", help="Inner corners of the chessboard.")] = "9x6",
) -> None:
    """Write the rig.json of a folder of images. The pose of the cameras is a matter of tactune calibrate."""
    from ...core.calibration.lens import make_rig
    from ...core.sources.folder import first_image_sizes, write_rig

    sizes = {name: (width, height) for name, (height, width) in first_image_sizes(folder).items()}
    board = re.fullmatch(r"(\d+)x(\d+)", corners)
    if board is None:
        raise typer.BadParameter(f"--corners is {corners!r}; write the inner corners as 9x6")
    size = int(board[1]), int(board[2])
    cameras = {
        "proximity": _camera(proximity, "depth", sizes["proximity_depth.png"], size),
        "tactile": _camera(tactile, "depth", sizes["tactile_depth.png"], size),
    }
    if sizes["proximity_color.png"] != sizes["proximity_depth.png"]:
        model, _, how = proximity.partition("=")
        color = proximity_color or (proximity if how == "camera" else model)
        lens = _camera(color, "colour", sizes["proximity_color.png"], size)
        cameras["proximity_color"] = {key: lens[key] for key in lens if key not in ("model", "depth_unit_m")}
    write_rig(folder, make_rig(cameras))
    typer.echo(f"wrote {folder / 'rig.json'}")


def _camera(text: str, kind: str, size: tuple[int, int], corners: tuple[int, int]) -> dict[str, Any]:
    """Return a camera as ``rig.json`` has it, from an option such as ``D405=boards``."""
    from pydantic import ValidationError

    from ...core.calibration.lens import MODELS, fit_lens, nominal_lens
    from ...core.model.intrinsics import Intrinsics
    from ...core.model.rig_file import validation_sentence

    name, _, how = text.partition("=")
    if name not in MODELS:
        raise typer.BadParameter(
            f"{text!r}: the model is {name!r}; choose {', '.join(MODELS)}, or write rig.json by hand"
        )
    unit_m = MODELS[name].depth_unit_m
    lens: Intrinsics
    if how in ("", "nominal"):
        lens = nominal_lens(*size, MODELS[name].views_deg[kind])
        warn(
            f"the {kind} lens of the {name} is the maker's, not measured: positions to the side are wrong by a few per "
            f"cent; give {name}=camera, or {name}=DIR with pictures of a chessboard"
        )
    elif how == "camera":
        lens, unit_m = _connected(name, "color" if kind == "colour" else kind, size)
    elif len(numbers := how.split(",")) == 4:
        try:
            fx, fy, cx, cy = map(float, numbers)
        except ValueError as error:
            raise typer.BadParameter(f"{text!r}: write four numbers, fx,fy,cx,cy in px") from error
        try:
            lens = Intrinsics(width=size[0], height=size[1], fx=fx, fy=fy, cx=cx, cy=cy)
        except ValidationError as error:
            raise typer.BadParameter(validation_sentence(error, repr(text), "a lens")) from error
    else:
        with CliProgress() as progress:
            fit = fit_lens(Path(how), *corners, size, progress.preparing)
        rejected = f"; rejected: {', '.join(fit.refused)}" if fit.refused else ""
        typer.echo(
            f"{how}: {fit.used} pictures, {fit.rms_px:.2f} px RMS, fx ± {fit.focal_sd_px:.1f} px{rejected}", err=True
        )
        lens = fit.intrinsics
    return {"model": name, "depth_unit_m": unit_m, **lens.model_dump(mode="json")}


def _connected(model: str, kind: str, size: tuple[int, int]) -> tuple[Intrinsics, float]:
    """Return the lens that a connected camera states for images of this size, and its depth unit in metres."""
    from ...core.sources.cameras.drivers import list_devices, list_lenses

    lenses = list_lenses()
    for device in list_devices()[0]:
        for lens in lenses.get(device.serial, []) if model in device.model else []:
            if lens.kind == kind and (lens.intrinsics.width, lens.intrinsics.height) == size:
                return lens.intrinsics, lens.depth_unit_m
    raise CalibrationError(
        f"no connected {model} states a {kind} lens for {size[0]} x {size[1]} pixels; tactune devices"
    )
