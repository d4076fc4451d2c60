"""The preset: all calibrated and tuned values, as one strict, frozen model."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Annotated, Any, Final, Literal

import numpy as np
from pydantic import Field, ValidationError

from ..contact import CONTACT_TESTS
from ..contact.contact_test import ContactTest
from ..contact.membrane.section import MembraneSection
from ..contact.pressure.section import PressureSection
from ..contact.tolerance import OutlierSection, ToleranceSection
from ..errors import PresetError
from ..model.alignment import AlignmentSection
from ..model.frames import Rig
from ..model.rig_file import field_sentence
from ..model.rig_noise import RigNoise, Verdict
from ..model.sections import (
    CamerasSection,
    MaskSection,
    RangeSection,
    RegionSection,
    Section,
    UntouchedRecord,
    described,
    stored,
)

Document = dict[str, Any]

SCHEMA_NAME: Literal["tactune.preset"] = "tactune.preset"
SCHEMA_VERSION: Final[Literal[1]] = 1

#: Fields on which no verdict depends.
_UNJUDGED: Final = dict.fromkeys(
    ("name", "notes", "created", "modified", "rig", "cameras", "untouched", "suggested", "verdict"), True
) | {"pressure": {"gauge_pa": True, "gauge_sigma_pa": True}}
#: A message names at most this many bad fields.
_MAX_ERRORS: Final = 7


def now() -> datetime:
    """Return the present moment in UTC, to the second, as presets store it."""
    return datetime.now(UTC).replace(microsecond=0)


class Preset(Section):
    """All calibrated and tuned values, and the rig that they were made for.

    ``rig`` is None for a preset that serves any rig. `tactune.core.sources.presets` loads presets,
    `tactune.core.preset.file` saves them.
    """

    name: Annotated[str, Field(min_length=1, max_length=120)] = "untitled"
    notes: Annotated[str, Field(max_length=10_000)] = ""
    created: datetime = Field(default_factory=now)
    modified: datetime = Field(default_factory=now)
    rig: Rig | None = None
    alignment: AlignmentSection = AlignmentSection()
    contact_test: Annotated[
        Literal["membrane", "tolerance", "pressure"],
        described("Contact test", " ".join(f"{test.name}: {test.summary}" for test in CONTACT_TESTS.values())),
    ] = "membrane"
    mask: MaskSection = MaskSection(enabled=False)
    # the sections of the contact tests
    membrane: MembraneSection = MembraneSection()
    tolerance: ToleranceSection = ToleranceSection()
    outliers: OutlierSection = OutlierSection()
    pressure: PressureSection = PressureSection()
    range: RangeSection = RangeSection()
    region: RegionSection = RegionSection()
    cameras: CamerasSection = CamerasSection()
    untouched: Annotated[
        UntouchedRecord | None,
        stored(
            "Untouched frame",
            "The untouched membrane, which some methods and the drift check compare with. Empty: not captured.",
        ),
    ] = None
    noise: Annotated[
        RigNoise | None,
        stored("Noise and bias", "The measured noise of both cameras and the bias between them. Empty: not measured."),
    ] = None
    suggested: Annotated[
        datetime | None,
        stored("Suggested", "When the suggestions for mask, contact test and limits were taken. Empty: never."),
    ] = None
    verdict: Annotated[
        Verdict | None,
        stored("Verdict", "How far the boundary of a patch is off with these values. Empty: not judged."),
    ] = None

    @property
    def test(self) -> type[ContactTest]:
        return CONTACT_TESTS[self.contact_test]

    @property
    def averaged_frames(self) -> int:
        """Maximum number of averaged frames; with 1, no result depends on earlier frames."""
        return int(self.value(self.test.frames_field)) if self.test.frames_field else 1

    def with_value(self, path: str, value: Any) -> Preset:
        """Return a copy with the field at a dotted path changed, such as ``"mask.hue"``, validated as a whole.

        `PresetError` names a field that does not exist, or a value that is not allowed.
        """
        return self.with_values({path: value})

    def with_values(self, values: dict[str, Any]) -> Preset:
        """Return a copy with several fields changed at once; see `with_value`."""
        data = self.model_dump(mode="python")
        for path, value in values.items():
            set_path(data, path, value)
        after = parse_preset(data, origin="preset")
        if after.verdict is None or "verdict" in values or after.judged_values() == self.judged_values():
            return after
        return after.model_copy(update={"verdict": None})

    def judged_values(self) -> Document:
        """Return the values on which a verdict depends."""
        return self.model_dump(exclude=_UNJUDGED)

    def value(self, path: str) -> Any:
        """Return the field at a dotted path, such as ``"tolerance.t"``."""
        target: Any = self
        for part in path.split("."):
            target = getattr(target, part)
        return target


class PresetDocument(Preset):
    """A preset file: the preset, and the name and version of the format."""

    schema_name: Annotated[Literal["tactune.preset"], Field(alias="schema")] = SCHEMA_NAME
    schema_version: Literal[1] = SCHEMA_VERSION
    tool_version: str = ""


def parse_preset(document: Document, origin: str) -> Preset:
    """Validate plain data; `PresetError` names the first bad fields, each with path, value and what is allowed."""
    text = json.dumps(document, default=_plain)
    try:
        parsed = PresetDocument.model_validate_json(text, strict=True, by_alias=True)
    except ValidationError as error:
        details = error.errors(include_url=False)
        sentences = [f"{field_sentence(detail, 'a preset')}{_meant(detail)}" for detail in details[:_MAX_ERRORS]]
        if len(details) > _MAX_ERRORS:
            sentences.append(f"and {len(details) - _MAX_ERRORS} more")
        raise PresetError(f"{origin}: " + "; ".join(sentences)) from error
    return Preset.model_construct(**{name: getattr(parsed, name) for name in Preset.model_fields})


def json_schema() -> Document:
    """Return the JSON Schema of preset files (draft 2020-12)."""
    schema = PresetDocument.model_json_schema(by_alias=True, mode="validation")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "Tactune preset",
        "required": ["schema", "schema_version"],
    }


def set_path(document: Document, path: str, value: Any) -> None:
    """Set the value at a dotted path in plain preset data; `PresetError` suggests the nearest field."""
    known = preset_paths()
    if path not in known:
        hint = difflib.get_close_matches(path, known, n=1)
        remedy = f"did you mean {hint[0]}?" if hint else f"fields are {', '.join(known)}"
        raise PresetError(f"a preset has no field {path!r}; {remedy}")
    *parents, last = path.split(".")
    for parent in parents:
        document = document[parent]
    document[last] = value


def json_or_word(text: str) -> Any:
    """Return the value of a JSON text, or else the text itself: a field's value as people write it."""
    try:
        return json.loads(text)
    except (ValueError, RecursionError):
        return text


def preset_paths() -> list[str]:
    """Return the dotted path of every field that can be set by itself."""

    def walk(model: Any, prefix: str) -> Iterator[str]:
        for name, field in model.model_fields.items():
            inner = field.annotation
            if isinstance(inner, type) and hasattr(inner, "model_fields"):
                yield from walk(inner, f"{prefix}{name}.")
            else:
                yield prefix + name

    return list(walk(Preset, ""))


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if hasattr(value, "isoformat"):
        return value.isoformat()
    raise PresetError(f"a preset cannot hold {value!r} of type {type(value).__name__}; use numbers, texts and lists")


def _meant(detail: Any) -> str:
    """Return which field an unknown one may mean, in brackets."""
    if detail["type"] != "extra_forbidden":
        return ""
    hint = difflib.get_close_matches(".".join(map(str, detail["loc"])), preset_paths(), n=1)
    return f" (did you mean {hint[0]}?)" if hint else ""
