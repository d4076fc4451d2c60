"""Description of a preset field for widgets, read from the pydantic model."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, Literal, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from ...core.errors import minus

Kind = Literal["flag", "choice", "number", "range", "rectangle", "matrix"]

#: Model unit -> factor and suffix of the displayed number, and the unit in words.
_UNITS: dict[str, tuple[float, str, str]] = {
    "": (1.0, "", ""),
    "m": (1000.0, " mm", "millimetres"),
    "s": (1000.0, " ms", "milliseconds"),
    "mm2": (1.0, " mm²", "square millimetres"),
    "px": (1.0, " px", "pixels"),
    "points": (1.0, "", "a number of points"),
    "sigma": (1.0, " σ", "standard deviations"),
    "share": (100.0, " %", "per cent"),
    "deg/2": (1.0, "", "half degrees, 0 to 179"),
}


@dataclass(frozen=True)
class FieldSpec:
    """One field of the preset, as a widget shows it.

    Bounds, ``slider`` and ``step`` are in the model's unit; a value times ``factor`` is what people read,
    followed by ``suffix``. ``advanced`` fields are behind a fold.
    """

    path: str
    title: str
    description: str
    kind: Kind
    default: Any
    unit: str = ""
    factor: float = 1.0
    suffix: str = ""
    minimum: float = 0.0
    maximum: float = 1.0
    open_minimum: bool = False
    slider: tuple[float, float] = (0.0, 1.0)
    step: float = 1.0
    log: bool = False
    wraps: bool = False
    integer: bool = False
    choices: tuple[str, ...] = ()
    advanced: bool = False

    @property
    def name(self) -> str:
        return self.path.rpartition(".")[2]

    @property
    def tooltip(self) -> str:
        parts = [self.description]
        words = _UNITS.get(self.unit, (1.0, "", ""))[2]
        if words and self.kind != "matrix":
            parts.append(f"In {words}.")
        if self.kind in ("number", "range"):
            low, high = (minus(format_number(bound * self.factor)) for bound in (self.minimum, self.maximum))
            parts.append(f"Allowed: {'above ' if self.open_minimum else ''}{low} to {high}{self.suffix}.")
        return " ".join(parts)

    def allows(self, value: float) -> bool:
        return value <= self.maximum and (value > self.minimum if self.open_minimum else value >= self.minimum)

    @property
    def decimals(self) -> int:
        """Number of displayed decimals: one more than the step has, or the resolution of a logarithmic slider."""
        of_step = len(format_number(self.step * self.factor).partition(".")[2])
        return of_step + (2 if self.log else 0 if self.integer else 1)

    def shown(self, value: float) -> str:
        """Format a number for display, with its unit; rounded, but never to zero."""
        return minus(self.bare(value)) + self.suffix

    def bare(self, value: float) -> str:
        number = value * self.factor
        rounded = round(number, self.decimals)
        return format_number(rounded or float(f"{number:.2g}"), 15)

    def describe(self, value: Any) -> str:
        if value is None:
            return "the rig's own"
        if self.kind == "number":
            return self.shown(value)
        if self.kind == "range":
            return " to ".join(minus(format_number(end * self.factor)) for end in value) + self.suffix
        if self.kind == "rectangle":
            return " x ".join(format_number(end) for end in value) + self.suffix
        if self.kind == "flag":
            return "on" if value else "off"
        return "the saved matrix" if self.kind == "matrix" else str(value)

    def from_shown(self, number: float) -> float | int:
        if self.integer:
            return round(number)
        return number if self.factor == 1.0 else float(f"{number / self.factor:.12g}")


def format_number(value: float, digits: int = 6) -> str:
    """Write a number without exponent or trailing zeros, to ``digits`` significant digits."""
    text = f"{float(f'{value:.{digits}g}'):.12f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


def section_fields(model: type[BaseModel], prefix: str) -> Iterator[FieldSpec]:
    """Yield the fields of a preset section, nested models included, in their order; hidden ones are left out."""
    for name, info in model.model_fields.items():
        path = f"{prefix}.{name}"
        if isinstance(info.json_schema_extra, dict) and info.json_schema_extra.get("hidden"):
            continue
        if isinstance(info.annotation, type) and issubclass(info.annotation, BaseModel):
            yield from section_fields(info.annotation, path)
        else:
            yield _read_field(path, info)


def field_spec(model: type[BaseModel], path: str) -> FieldSpec:
    """Return one field by its dotted path, also a hidden one."""
    *parents, last = path.split(".")
    for parent in parents:
        inner = model.model_fields[parent].annotation
        assert isinstance(inner, type) and issubclass(inner, BaseModel)
        model = inner
    return _read_field(path, model.model_fields[last])


def _read_field(path: str, info: FieldInfo) -> FieldSpec:
    extra: dict[str, Any] = info.json_schema_extra if isinstance(info.json_schema_extra, dict) else {}
    unit = str(extra.get("unit", ""))
    factor, suffix, _ = _UNITS.get(unit, (1.0, f" {unit}", ""))
    title = info.title or path.rpartition(".")[2].replace("_", " ").capitalize()
    default = info.get_default(call_default_factory=True)
    common: dict[str, Any] = {
        "path": path,
        "title": title,
        "description": info.description or "",
        "default": default,
        "unit": unit,
        "factor": factor,
        "suffix": suffix,
        "advanced": bool(extra.get("advanced", False)),
    }
    kind = _kind_of(path, info.annotation)
    if kind == "choice":
        return FieldSpec(kind=kind, choices=tuple(get_args(info.annotation)), **common)
    if kind in ("flag", "matrix"):
        return FieldSpec(kind=kind, **common)

    element, metadata = _element_of(info)
    bounds = _bounds_of(metadata)
    slider = extra.get("slider", (bounds["minimum"], bounds["maximum"]))
    integer = element is int
    span = float(slider[1]) - float(slider[0])
    return FieldSpec(
        kind=kind,
        integer=integer,
        slider=(float(slider[0]), float(slider[1])),
        step=float(extra.get("step", 1.0 if integer else span / 200.0)),
        log=extra.get("scale") == "log",
        wraps=bool(extra.get("wraps", False)),
        **bounds,
        **common,
    )


def _kind_of(path: str, annotation: Any) -> Kind:
    if annotation is bool:
        return "flag"
    if annotation in (int, float):
        return "number"
    if get_origin(annotation) is Literal:
        return "choice"
    if get_origin(annotation) is tuple:
        kinds: dict[int, Kind] = {2: "range", 4: "rectangle"}
        count = len(get_args(annotation))
        if count in kinds:
            return kinds[count]
    if type(None) in get_args(annotation):
        return "matrix"
    raise TypeError(f"{path}: no widget for a field of type {annotation}")


def _element_of(info: FieldInfo) -> tuple[Any, list[Any]]:
    """Return the number type of a field or of a tuple's items, and what bounds it."""
    if get_origin(info.annotation) is not tuple:
        return info.annotation, list(info.metadata)
    item = get_args(info.annotation)[0]
    if get_origin(item) is not Annotated:
        return item, []
    element, *annotations = get_args(item)
    metadata: list[Any] = []
    for annotation in annotations:
        metadata += annotation.metadata if isinstance(annotation, FieldInfo) else [annotation]
    return element, metadata


def _bounds_of(metadata: list[Any]) -> dict[str, Any]:
    bounds: dict[str, Any] = {"minimum": float("-inf"), "maximum": float("inf"), "open_minimum": False}
    for entry in metadata:
        for attribute, target in (("ge", "minimum"), ("gt", "minimum"), ("le", "maximum")):
            if hasattr(entry, attribute):
                bounds[target] = float(getattr(entry, attribute))
                bounds["open_minimum"] |= attribute == "gt"
    return bounds
