"""The parts of a preset that decide which pixels are contact."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator, model_validator

from .fields import Section, described

_Hue = Annotated[int, Field(ge=0, le=179)]
_Byte = Annotated[int, Field(ge=0, le=255)]


class MaskSection(Section):
    """The colour of the bare membrane: such pixels reflect infrared and would pass as contact."""

    enabled: Annotated[
        bool, described("Use the mask", "Drop pixels whose colour is the bare membrane's; they reflect infrared.")
    ] = True
    hue: Annotated[
        tuple[_Hue, _Hue],
        described(
            "Hue",
            "Hue range of the bare membrane, OpenCV convention 0-179. A low end above the high end wraps "
            "around through red.",
            unit="deg/2",
            wraps=True,
        ),
    ] = (0, 179)
    saturation: Annotated[
        tuple[_Byte, _Byte], described("Saturation", "Saturation range of the bare membrane, 0 grey to 255 pure.")
    ] = (0, 255)
    value: Annotated[
        tuple[_Byte, _Byte], described("Value", "Brightness range of the bare membrane, 0 black to 255 brightest.")
    ] = (0, 255)

    @model_validator(mode="after")
    def _ordered(self) -> MaskSection:
        for name in ("saturation", "value"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(
                    f"{name} has its low end {low} above its high end {high}; only hue wraps around, swap them"
                )
        return self


class ToleranceSection(Section):
    """The contact test |dp - dt| <= t |dp|."""

    t: Annotated[
        float,
        described(
            "Tolerance t",
            "A pixel is in contact where both distances agree within this share of the distance.",
            scale="log",
            slider=(0.001, 0.3),
            step=0.001,
        ),
        Field(ge=0.0, le=1.0),
    ] = 0.03


class OutlierSection(Section):
    """Statistical outlier removal (Open3D's definition) and the smallest cluster kept."""

    enabled: Annotated[
        bool, described("Remove outliers", "Drop points that lie unusually far from their neighbours.")
    ] = True
    k: Annotated[
        int,
        described(
            "Neighbours k",
            "Number of nearest points averaged for each point. The point itself counts as one, as in Open3D; "
            "PCL counts one less.",
            unit="points",
            slider=(1, 100),
        ),
        Field(ge=1, le=1000),
    ] = 20
    ratio: Annotated[
        float,
        described(
            "Ratio",
            "Points whose mean neighbour distance exceeds the mean by this many standard deviations are dropped.",
            unit="sigma",
            slider=(0.1, 5.0),
            step=0.1,
        ),
        Field(gt=0.0, le=100.0),
    ] = 2.0
    min_cluster_area_mm2: Annotated[
        float,
        described(
            "Smallest cluster",
            "Connected groups of contact pixels with a smaller area are dropped. 0 keeps all.",
            unit="mm2",
            slider=(0.0, 500.0),
            step=5.0,
        ),
        Field(ge=0.0, le=1e6),
    ] = 0.0


class MembraneSection(Section):
    """The contact test on local means of dp - dt. Chosen on the simulator's cube, cup, octopus, knobs and star."""

    gap_m: Annotated[
        float,
        described(
            "Largest gap",
            "Pixels whose local mean gap between membrane and object is smaller are near; contact lies within them. "
            "A limit below about 1 mm is lost in the sensors' noise.",
            unit="m",
            slider=(0.0002, 0.003),
            step=0.0001,
        ),
        Field(ge=0.0, le=0.02),
    ] = 0.0014
    erosion: Annotated[
        float,
        described(
            "Erosion",
            "Share of the estimated non-touching rim that is eroded. The membrane leaves the object at a tangent, so "
            "a rim around contact is near without touching; its width is estimated from how fast the gap grows "
            "there. 0 keeps the rim.",
            slider=(0.0, 1.5),
            step=0.05,
        ),
        Field(ge=0.0, le=2.0),
    ] = 0.9
    window_px: Annotated[
        float,
        described(
            "Averaging",
            "Sigma of the Gaussian window over which gaps are averaged. A wider window resolves smaller gaps but "
            "blurs the edge. 0 averages nothing.",
            unit="px",
            slider=(0.0, 8.0),
            step=0.5,
        ),
        Field(ge=0.0, le=20.0),
    ] = 2.5
    bias_m: Annotated[
        float,
        described(
            "Largest bias",
            "Upper limit of the estimated bias between both cameras. The bias is estimated from the masked prints "
            "and from the most frequent gap, and subtracted. 0 disables the correction.",
            unit="m",
            slider=(0.0, 0.005),
            step=0.0001,
        ),
        Field(ge=0.0, le=0.02),
    ] = 0.0012
    min_area_mm2: Annotated[
        float,
        described(
            "Smallest contact",
            "Connected contacts with a smaller area are dropped. 0 keeps all.",
            unit="mm2",
            slider=(0.0, 100.0),
            step=1.0,
        ),
        Field(ge=0.0, le=1e6),
    ] = 5.0
    curvature: Annotated[
        float,
        described(
            "Largest curvature",
            "Contact needs a membrane curvature below this share of the free membrane's, because a pressing object "
            "flattens the membrane. Lightly touching regions are kept if their gap is no larger than in firm contact. "
            "It separates touching from hovering. 0 disables the test.",
            slider=(0.0, 1.5),
            step=0.05,
        ),
        Field(ge=0.0, le=10.0),
    ] = 0.7
    balance: Annotated[
        bool,
        described(
            "Balanced edge",
            "End contact where a membrane in equilibrium of tension and pressure leaves the measured object. This "
            "narrows light contacts, which are otherwise too wide.",
        ),
    ] = True
    frames: Annotated[
        int,
        described(
            "Averaged frames",
            "Number of frames over which depth is averaged while the membrane is still, which reveals small contacts. "
            "Averaging restarts where the membrane moves. 1 averages nothing; larger values take effect during "
            "playback only.",
            slider=(1, 30),
        ),
        Field(ge=1, le=300),
    ] = 1
    difference_m: Annotated[
        float,
        described(
            "Largest difference",
            "Pixels whose two depths differ by more are excluded from the means: background, flying pixels.",
            unit="m",
            hidden=True,
        ),
        Field(gt=0.0, le=0.1),
    ] = 0.008
    slope: Annotated[
        bool,
        described(
            "Along the normal", "Measure gaps along the surface normal, not along the optical axis.", hidden=True
        ),
    ] = True
    core_share: Annotated[
        float,
        described(
            "Protected core",
            "Pixels farther from the border of a near region than this share of its depth are never eroded.",
            hidden=True,
        ),
        Field(ge=0.0, le=1.0),
    ] = 0.5
    max_erosion_px: Annotated[
        float,
        described("Widest erosion", "Upper limit of the eroded rim's width.", unit="px", hidden=True),
        Field(ge=0.0, le=100.0),
    ] = 16.0
    curvature_px: Annotated[
        float,
        described(
            "Window of the curvature",
            "Sigma of the Gaussian window over which the membrane's curvature is averaged, in tactile pixels.",
            unit="px",
            hidden=True,
        ),
        Field(ge=1.0, le=50.0),
    ] = 11.0
    smooth_px: Annotated[
        float,
        described(
            "Smoothing of points",
            "Sigma of the Gaussian window over which the depth of the points is averaged. 0 averages nothing.",
            unit="px",
            hidden=True,
        ),
        Field(ge=0.0, le=20.0),
    ] = 2.0
    tactile_weight: Annotated[
        float,
        described(
            "Weight of the tactile depth",
            "Weight of the tactile depth in the contact points; the proximity depth has the rest.",
            hidden=True,
        ),
        Field(ge=0.0, le=1.0),
    ] = 0.5


class RangeSection(Section):
    """The working range: proximity depths outside it are never contact."""

    enabled: Annotated[bool, described("Limit the range", "Ignore points nearer or farther than the range.")] = False
    limits_m: Annotated[
        tuple[Annotated[float, Field(ge=0.0, le=10.0)], Annotated[float, Field(ge=0.0, le=10.0)]],
        described("Range", "Nearest and farthest proximity depth considered.", unit="m", slider=(0.0, 1.0), step=0.001),
    ] = (0.1, 0.5)

    @field_validator("limits_m")
    @classmethod
    def _ordered(cls, value: tuple[float, float]) -> tuple[float, float]:
        if value[0] >= value[1]:
            raise ValueError(f"the near limit {value[0]} m is not below the far limit {value[1]} m; swap them")
        return value


_Pixel = Annotated[int, Field(ge=0, le=16384)]


class RegionSection(Section):
    """A rectangle of proximity pixels; nothing outside it is computed."""

    enabled: Annotated[bool, described("Limit the region", "Ignore pixels outside the rectangle.")] = False
    rectangle: Annotated[
        tuple[_Pixel, _Pixel, _Pixel, _Pixel],
        described("Rectangle", "Left, top, width and height in proximity pixels.", unit="px"),
    ] = (0, 0, 640, 480)

    @field_validator("rectangle")
    @classmethod
    def _not_empty(cls, value: tuple[int, int, int, int]) -> tuple[int, int, int, int]:
        if value[2] == 0 or value[3] == 0:
            raise ValueError(f"the region is {value[2]} x {value[3]} pixels and so empty; give it a size")
        return value
