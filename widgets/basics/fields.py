"""Description of a preset field for widgets, read from the pydantic model."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

from pydantic import BaseModel

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
        if isinstance(info.annotation, type) and issubclass(info.annotation, BaseModel):
            yield from section_fields(info.annotation, path)
        elif not _schema(model)[name].get("hidden"):
            yield _read_field(model, path)


def field_spec(model: type[BaseModel], path: str) -> FieldSpec:
    """Return one field by its dotted path, also a hidden one."""
    for parent in path.split(".")[:-1]:
        inner = model.model_fields[parent].annotation
        assert isinstance(inner, type) and issubclass(inner, BaseModel)
        model = inner
    return _read_field(model, path)


@cache
def _schema(model: type[BaseModel]) -> dict[str, dict[str, Any]]:
    """Return what JSON schema says of each field of a model: bounds, choices, and our own keys such as ``unit``."""
    properties: dict[str, dict[str, Any]] = model.model_json_schema()["properties"]
    return properties


def _read_field(model: type[BaseModel], path: str) -> FieldSpec:
    name = path.rpartition(".")[2]
    info, node = model.model_fields[name], _schema(model)[name]
    unit = node.get("unit", "")
    factor, suffix, _ = _UNITS.get(unit, (1.0, f" {unit}", ""))
    number = node.get("prefixItems", [node])[0]  # all numbers of a range or rectangle have the same bounds
    minimum = float(number.get("exclusiveMinimum", number.get("minimum", -math.inf)))
    maximum = float(number.get("maximum", math.inf))
    low, high = map(float, node.get("slider", (minimum, maximum)))
    integer = number.get("type") == "integer"
    return FieldSpec(
        path=path,
        title=info.title or name.replace("_", " ").capitalize(),
        description=info.description or "",
        kind=_kind_of(path, node),
        default=info.get_default(call_default_factory=True),
        unit=unit,
        factor=factor,
        suffix=suffix,
        minimum=minimum,
        maximum=maximum,
        open_minimum="exclusiveMinimum" in number,
        slider=(low, high),
        step=float(node.get("step", 1.0 if integer else (high - low) / 200.0)),
        log=node.get("scale") == "log",
        wraps=node.get("wraps", False),
        integer=integer,
        choices=tuple(node.get("enum", ())),
        advanced=node.get("advanced", False),
    )


def _kind_of(path: str, node: dict[str, Any]) -> Kind:
    if "anyOf" in node:  # or None
        return "matrix"
    if "enum" in node:
        return "choice"
    kinds: dict[str, Kind] = {"boolean": "flag", "integer": "number", "number": "number"}
    if len(node.get("prefixItems", ())) in (2, 4):
        kinds["array"] = "range" if len(node["prefixItems"]) == 2 else "rectangle"
    if node.get("type") not in kinds:
        raise TypeError(f"{path}: no widget for a field of this type")
    return kinds[node["type"]]
