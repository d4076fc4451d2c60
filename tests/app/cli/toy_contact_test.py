"""A minimal contact test: both depths differ by less than a fixed length. Adding it needs only this file."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from ..model.clouds import deproject
from ..model.patch import Candidates, Found, Provenance
from ..model.sections import Section, described
from .contact_test import PIXEL_FIELDS, BiasLimits, ContactTest, DropReason


class ToySection(Section):
    """Its parameters."""

    limit_m: Annotated[float, described("Toy limit", "Largest difference.", unit="m"), Field(ge=0.0, le=0.1)] = 0.005
    left_px: Annotated[int, described("Toy border", "First column.", unit="px"), Field(ge=0, le=10_000)] = 0


class ToyTest(ContactTest):
    """Everything that is to know about it."""

    name = "toy"
    sections = {"toy": ToySection}
    steps = {"compare": (*PIXEL_FIELDS, "toy.limit_m"), "border": ("toy.left_px",)}
    summary = "both depths differ by less than a length."
    note = "A toy."
    looser_words = "raise the toy limit"
    drop_reasons = {Provenance.SMALL_CLUSTER: DropReason("the toy border", "lower it")}

    def find(self, frame: Any, preset: Any, due: Any) -> Found:
        if due("compare"):
            aligned = self.pixels.aligned(frame)
            with np.errstate(invalid="ignore"):
                self.near = np.abs(aligned.expected_m - aligned.measured_m) < preset.toy.limit_m
        if due("border"):
            self.kept = self.near.copy()
            self.kept[:, : preset.toy.left_px] = False
        pixels = np.flatnonzero(self.kept)
        contact = Candidates(pixels, deproject(frame.proximity_depth, self.pixels.rig.proximity, pixels))
        near, kept = self.near, self.kept
        verdicts = np.where(kept, Provenance.CONTACT, np.where(near, Provenance.SMALL_CLUSTER, 4)).astype(np.uint8)
        return Found(contact, lambda: verdicts)

    @classmethod
    def accepted_share(cls, preset: Any, distance_m: float) -> float:
        return float(preset.toy.limit_m / distance_m)

    @classmethod
    def bias_limits(cls, preset: Any, distance_m: float) -> BiasLimits:
        return BiasLimits(preset.toy.limit_m / 3, preset.toy.limit_m, "a third of the toy limit")
