"""What all parts of a preset are made of: strict, frozen sections of fields that describe themselves."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field


def described(title: str, description: str, *, unit: str = "", **extra: Any) -> Any:
    """Bounds aside, what the GUI needs to know of a field: title, unit, tooltip and scale."""
    return Field(title=title, description=description, json_schema_extra={"unit": unit, **extra})


class Section(BaseModel):
    """A frozen, strict part of a preset."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
