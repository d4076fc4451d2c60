"""The command ``tactune evaluate recording``: contact from paint on a scan."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from ...core.errors import TactuneError
from ...core.model.files import finite_or_none, write_csv
from ...core.model.units import UNITS_M, MeshUnit
from .common import (
    FUSION,
    CliProgress,
    default_preset,
    number_of_frames,
    open_with_progress,
    warn,
)

if TYPE_CHECKING:
    from ...core.evaluation.scan.paint import PaintSettings, ScanTruth
    from ...core.evaluation.scan.pose import RefinedPose
    from ...core.evaluation.scan.scan import Scan
    from ...core.model.arrays import BoolArray
    from ...core.model.frames import Matrix4, SensorFrame
    from ...core.preset import Preset
    from ...core.sources import FrameSource
    from .methods import Step

Record = dict[str, Any]

#: Columns of the table and their titles.
_COLUMNS: Final = {
    "symmetric_rmse_mm": "RMSE mm",
    "patch_to_truth_rms_mm": "patch>scan mm",
    "truth_to_patch_rms_mm": "scan>patch mm",
    "hausdorff_mm": "Hausdorff mm",
    "percentile_95_mm": "95 % mm",
    "chamfer_mm": "Chamfer mm",
    "area_error_mm2": "area error mm2",
}
_REFINED: Final = ("rmse_m", "pairs", "iterations", "converged")
#: Above this distance the transform is wrong, not the method.
_FAR_MM: Final = 40.0


def evaluate_recording(
    *,
    source: Annotated[str, typer.Option("--source", "-s", metavar="SOURCE", help="As for tactune run.")],
    scan: Annotated[
        Path, typer.Option(metavar="FILE", help="The object's painted scan: .ply or .obj, coloured or textured.")
    ],
    transform: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help='Pose of the scan: JSON {"T_proximity_scan": 4 x 4}, or four lines of four.',
        ),
    ] = None,
    pairs: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.csv",
            help="Or point pairs picked on both: scan_x,scan_y,scan_z (the scan's unit),patch_x_m,patch_y_m,patch_z_m.",
        ),
    ] = None,
    refine: Annotated[
        bool, typer.Option("--refine", help="Refine the pose by ICP to the first method's patch in the first frame.")
    ] = False,
    method: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="A method or 'all'; may be repeated. Default: fusion.")
    ] = None,
    untouched: Annotated[
        str | None,
        typer.Option(metavar="SOURCE", help="First frame: the untouched membrane, for methods that need it."),
    ] = None,
    frame: Annotated[int | None, typer.Option(min=0, metavar="N", help="Only this frame, from 0.")] = None,
    frames: Annotated[str | None, typer.Option(metavar="A:B", help="Frames A to B, both included.")] = None,
    preset: Annotated[
        str | None, typer.Option("--preset", "-p", metavar="FILE|NAME", help="As for tactune run.")
    ] = None,
    unit: Annotated[MeshUnit | None, typer.Option(help="Unit of the scan's numbers; default: m.")] = None,
    paint: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE",
            help="Colour of touched paint and filter of its spots: hue=150:179 (0-179; may wrap), "
            "saturation=40:255, value=60:255, least_area_mm2=20, largest=0. May be repeated.",
        ),
    ] = None,
    save_transform: Annotated[
        Path | None, typer.Option(metavar="FILE.json", help="Write the pose that was used, refined or not.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
    csv_file: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Also write one line per method and frame.")
    ] = None,
) -> None:
    """Compare methods with the contact that thermochromic paint shows on the object's 3D scan.

    --refine hides errors that all patch points share; a pose that was measured without the patch is fairer.
    """
    from ...core.evaluation.scan.paint import scan_truth
    from ...core.evaluation.scan.pose import save_transform as write_transform
    from ...core.evaluation.scan.scan import load_scan
    from ...core.sources.presets import load_preset
    from .methods import frame_range, frames_between, remembered_frames

    unit_m = UNITS_M[unit or MeshUnit.M]
    first, last = frame_range(frame, frames)
    settings = parse_paint(paint or [])
    pose = _start_pose(scan, transform, pairs, unit_m)
    names = _methods(method or [], untouched)
    origin = preset or default_preset(source)
    chosen = load_preset(origin)
    loaded = load_scan(scan, unit_m)
    contact = _contact(loaded, settings, scan)
    refined, truth = None, scan_truth(loaded, contact, pose)
    records: list[Record] = []
    with open_with_progress(source, chosen.cameras) as opened, CliProgress() as progress:
        if opened.length is None and last is None:
            raise TactuneError(f"{source} is endless; choose the frames to evaluate, such as --frames 0:30")
        steps = _steps(names, opened, chosen, origin, untouched, leave_out="all" in (method or []))
        names = list(steps)
        remembered = {name: remembered_frames(name, chosen) for name in names}
        total = number_of_frames(opened, None if last is None else last + 1)
        for index, each in frames_between(opened, first, last, before=max(remembered.values()) - 1):
            if index < first:
                for name in names:
                    if first - index < remembered[name]:
                        steps[name](each)
                continue
            if refine and refined is None:
                refined = _refined(loaded, contact, pose, steps[names[0]], each)
                pose = refined.T_proximity_scan
                truth = scan_truth(loaded, contact, pose)
            records += [_scored(name, step, each, truth) for name, step in steps.items()]
            progress.frames(len(records) // len(names), total and total - first)
    _warn_of_places(records)
    if unit is None:
        sides = " x ".join(
            f"{1e3 * side:.0f}" for side in loaded.vertices_m.max(axis=0) - loaded.vertices_m.min(axis=0)
        )
        warn(f"{scan.name} was read in m: {sides} mm; say --unit if that is wrong")
    if save_transform is not None:
        write_transform(save_transform, pose)
    if csv_file is not None:
        write_csv(csv_file, records)
    if as_json:
        found = {"scan": str(scan), "contact_mm2": truth.area_mm2, "T_proximity_scan": pose}
        found["refined"] = refined and {name: getattr(refined, name) for name in _REFINED}
        typer.echo(json.dumps(found | {"results": records}, allow_nan=False))
    else:
        typer.echo(_table(records, truth.area_mm2, refined))
    for written in filter(None, (save_transform, csv_file)):
        typer.echo(f"wrote {written}", err=True)


def parse_paint(words: list[str]) -> PaintSettings:
    """Turn ``NAME=VALUE`` texts such as ``hue=150:179`` into settings; the others keep their defaults.

    Raises
    ------
    TactuneError
        A name is unknown or a value is not valid.
    """
    from ...core.evaluation.scan.paint import PaintSettings

    values: Record = {}
    for word in words:
        name, _, text = word.partition("=")
        try:
            if name in ("hue", "saturation", "value"):
                low, high = text.split(":")
                values[name] = int(low), int(high)
            elif name == "least_area_mm2":
                values[name] = float(text)
            elif name == "largest":
                values[name] = int(text)
            else:
                raise TactuneError(
                    f"--paint knows no {name!r}; known are hue, saturation, value, least_area_mm2 and largest"
                )
        except ValueError as error:
            raise TactuneError(
                f"--paint {word!r}: write hue=150:179, saturation=40:255, value=60:255, least_area_mm2=20 or largest=2"
            ) from error
    return PaintSettings(**values)


def _start_pose(scan: Path, transform: Path | None, pairs: Path | None, unit_m: float) -> Matrix4:
    """Return ``T_proximity_scan`` from the options."""
    from ...core.evaluation.scan.pose import load_transform, pose_from_pairs, read_pairs

    if transform is not None and pairs is not None:
        raise TactuneError("--transform and --pairs both give the pose of the scan; give one of them")
    if transform is None and pairs is None:
        raise TactuneError(
            f"the pose of {scan} is not given: add --transform FILE or --pairs FILE.csv; "
            "the window aligns scans and saves the transform (Analysis > Ground truth)"
        )
    if transform is not None:
        return load_transform(transform)
    assert pairs is not None
    return pose_from_pairs(*read_pairs(pairs, unit_m))


def _contact(scan: Scan, paint: PaintSettings, path: Path) -> BoolArray:
    from ...core.evaluation.scan.paint import painted_contact

    contact = painted_contact(scan, paint)
    if not contact.any():
        raise TactuneError(
            f"{path} has no spot of the touched paint's colour, hue {paint.hue[0]}:{paint.hue[1]}, saturation "
            f"{paint.saturation[0]}:{paint.saturation[1]}, value {paint.value[0]}:{paint.value[1]}, of at least "
            f"{paint.least_area_mm2:g} mm2; change the range with --paint"
        )
    return contact


def _methods(asked: list[str], untouched: str | None) -> list[str]:
    """Return the methods' names, each once and known."""
    from ...core.methods.registry import method_names, needs_untouched
    from .methods import read_untouched

    names = list(dict.fromkeys([FUSION, *method_names()] if "all" in asked else asked or [FUSION]))
    for name in names:
        read_untouched(name, None)
    if untouched is not None and not any(map(needs_untouched, names)):
        raise TactuneError(f"{' and '.join(names)} need no untouched frame; remove --untouched")
    return names


def _steps(
    names: list[str], source: FrameSource, preset: Preset, origin: str, untouched: str | None, *, leave_out: bool
) -> dict[str, Step]:
    """Return each method's step; one that cannot work here is skipped with a warning (``leave_out``) or refused."""
    from ...core.methods.registry import needs_untouched
    from .methods import make_step, read_untouched

    needing = [name for name in names if needs_untouched(name)]
    compared_with = read_untouched(needing[0], untouched) if needing else None
    steps = {}
    for name in names:
        try:
            steps[name] = make_step(name, preset, origin, source, compared_with)
        except TactuneError as error:
            if not leave_out:
                raise
            warn(f"skipped: {error}")
    if not steps:
        raise TactuneError(f"no method can work with {source.name} and this preset; see the warnings above")
    return steps


def _refined(scan: Scan, contact: BoolArray, start: Matrix4, step: Step, frame: SensorFrame) -> RefinedPose:
    from ...core.evaluation.scan.paint import contact_points
    from ...core.evaluation.scan.pose import refine_pose

    _, patch = step(frame)
    return refine_pose(contact_points(scan, contact), patch.points, start)


def _scored(name: str, step: Step, frame: SensorFrame, truth: ScanTruth) -> Record:
    """Return the record of one method's patch in one frame."""
    from ...core.evaluation.scan.paint import score_against_scan
    from ...core.evaluation.table_cell import NO_CONTACT_FOUND

    said, patch = step(frame)
    scores = score_against_scan(patch.points, said["area_mm2"] or 0.0, truth)
    failure = said["failure"] or ("" if said["points"] else NO_CONTACT_FOUND)
    numbers = {key: finite_or_none(number) for key, number in scores.items()}
    start = {"sequence": said["sequence"], "method": name, "points": said["points"]}
    return start | numbers | {"failure": failure}


def _warn_of_places(records: list[Record]) -> None:
    known = [record["symmetric_rmse_mm"] for record in records if record["symmetric_rmse_mm"] is not None]
    if known and min(known) > _FAR_MM:
        warn(
            f"patch and scan lie {min(known):.0f} mm apart; check that the transform maps the scan frame to the "
            "proximity depth frame, not the reverse, in metres"
        )


def _table(records: list[Record], area_mm2: float, refined: RefinedPose | None) -> str:
    """Return one line per frame and method, and means if there are several frames."""
    lines = [f"painted contact: {area_mm2:.0f} mm2"]
    if refined is not None:
        end = "converged" if refined.converged else "not converged"
        lines.append(
            f"ICP to the first method's patch: {1e3 * refined.rmse_m:.3f} mm over {refined.pairs} pairs, "
            f"{end} after {refined.iterations} rounds"
        )
    widths = [len(title) for title in _COLUMNS.values()]
    lines.append("frame  method             points  " + "  ".join(_COLUMNS.values()))
    lines += [_line(str(record["sequence"]), record, widths) for record in records]
    names = list(dict.fromkeys(record["method"] for record in records))
    if len(records) > len(names):
        lines += [_line("mean", _mean(name, records), widths) for name in names]
    return "\n".join(lines)


def _line(label: str, record: Record, widths: list[int]) -> str:
    start = f"{label:>5}  {record['method']:17s}  {record['points']:6.0f}  "
    if record["failure"]:
        return f"{start}{record['failure']}"
    cells = (record[name] for name in _COLUMNS)
    return start + "  ".join(
        ("-" if number is None else f"{number:.3f}").rjust(width) for number, width in zip(cells, widths, strict=True)
    )


def _mean(name: str, records: list[Record]) -> Record:
    """Return the means over the frames in which a method found a patch."""
    good = [record for record in records if record["method"] == name and not record["failure"]]
    if not good:
        return {"method": name, "points": 0, "failure": "no patch in any frame"}
    means: Record = {column: sum(record[column] for record in good) / len(good) for column in ("points", *_COLUMNS)}
    return means | {"method": name, "failure": ""}
