"""The live simulator: a membrane pressed by an object, seen by two noisy cameras, with ground truth."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ..base import FrameSource, Progress, SourceKind
from .membranes import MEMBRANES
from .scene_list import SCENES
from .sensors import DEFAULT_SENSOR, SENSORS

if TYPE_CHECKING:
    from ...preset import CamerasSection


def _open(rest: str, progress: Progress | None, cameras: CamerasSection | None) -> FrameSource:
    """Open ``SCENE?sensor=NAME&seed=N&noise=X``; every part is optional."""
    from .names import read_name  # not above: it compiles kernels' modules
    from .scenes import read_options
    from .source import SimulatorSource

    values = read_name(rest)
    variant, light = read_options(f"sim:{rest}", values)
    return SimulatorSource(
        scene=values["scene"],
        seed=int(values["seed"]),
        noise=float(values["noise"]),
        progress=progress,
        variant=variant,
        light=light,
        sensor=values["sensor"],
    )


KIND = SourceKind(
    scheme="sim",
    title="Simulator",
    form="sim:SCENE[?press=medium&membrane=NAME&sensor=NAME&seed=N&noise=X]",
    description=(
        f"A simulated sensor with ground truth, pressed by an object: {', '.join(SCENES)}; mug and hand, held out for "
        "judging methods. hover stays gap=1...20 mm away and takes object=cup; tray: books roll a tray. press=low, "
        "medium or high holds a press, high at side=right or left, press=none shows the untouched membrane; move=slide "
        "turns and slides an object across folds for 5 s, move=lift also takes the cup's handle off the membrane; "
        f"grid=dots prints dots 10 mm apart; membrane={', '.join(MEMBRANES)}; light=bright or dim; noise=0, 1 or 2 "
        f"times the errors of sensor= ({DEFAULT_SENSOR} by default): {', '.join(SENSORS)}."
    ),
    needs="nothing",
    examples=tuple(f"sim:{scene}" for scene in SCENES),
    open=_open,
)
