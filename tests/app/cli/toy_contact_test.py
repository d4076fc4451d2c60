"""A minimal contact test: both depths differ by less than a fixed length. Adding it needs only this file."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from ..model.clouds import deproject
from ..model.patch import Candidates, Found
from ..model.provenance import Provenance
from .contact_test import PIXEL_FIELDS, BiasLimits, ContactTest, DropReason, FusionVariant, Step, TestSection
from .sections import Section, described


class ToySection(Section):
    """Its parameters."""

    limit_m: Annotated[float, described("Toy limit", "Largest difference.", unit="m"), Field(ge=0.0, le=0.1)] = 0.005
    left_px: Annotated[int, described("Toy border", "First column.", unit="px"), Field(ge=0, le=10_000)] = 0


class ToyTest(ContactTest[ToySection]):
    """Everything that is to know about it."""

    name = "toy"
    implementation = f"{__name__}:ToyFinder"
    sections = (TestSection("toy", "Toy test", ToySection),)
    steps = (Step("compare", (*PIXEL_FIELDS, "toy.limit_m")), Step("border", ("toy.left_px",)))
    summary = "both depths differ by less than a length."
    note = "A toy."
    looser_words = "raise the toy limit"
    drop_reasons = {Provenance.SMALL_CLUSTER: DropReason("the toy border", "lower it")}
    variants = (FusionVariant("fusion-toy", {"contact_test": "toy", "alignment.model": "rigid"}, "A toy.", (9, 9, 9)),)

    def accepted_share(self, section: ToySection, distance_m: float) -> float:
        return section.limit_m / distance_m

    def bias_limits(self, section: ToySection, distance_m: float) -> BiasLimits:
        return BiasLimits(section.limit_m / 3, section.limit_m, "a third of the toy limit")


class ToyFinder:
    """Computes it."""

    def __init__(self, preset: Any, rig: Any, alignment: Any, workspace: Any) -> None:
        self.rig, self.alignment, self.workspace = rig, alignment, workspace

    def find(self, frame: Any, preset: Any, due: Any) -> Found:
        if due("compare"):
            aligned = self.workspace.aligned(frame, self.alignment, preset.region)
            with np.errstate(invalid="ignore"):
                self.near = np.abs(aligned.expected_m - aligned.measured_m) < preset.toy.limit_m
        if due("border"):
            self.kept = self.near.copy()
            self.kept[:, : preset.toy.left_px] = False
        pixels = np.flatnonzero(self.kept)
        contact = Candidates(pixels, deproject(frame.proximity_depth, self.rig.proximity, pixels))
        near, kept = self.near, self.kept
        verdicts = np.where(kept, Provenance.CONTACT, np.where(near, Provenance.SMALL_CLUSTER, 4)).astype(np.uint8)
        return Found(contact, lambda: verdicts)


TOY = ToyTest()
