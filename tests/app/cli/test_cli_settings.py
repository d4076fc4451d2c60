"""``--set FIELD=VALUE`` on the preset that ``tactune run`` uses."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Tactune = Callable[..., Any]


def test_run_uses_the_preset_with_what_was_set(tactune: Tactune, recording: Path) -> None:
    def points(*settings: str) -> list[Any]:
        words = [word for setting in settings for word in ("--set", setting)]
        finished = tactune("run", "-s", recording, "-p", "default", "--json", *words)
        return [json.loads(line)["points"] for line in finished.out.splitlines()]

    assert points("outliers.enabled=false") == [0, 64, 256, 576]
    assert points("outliers.enabled=false", "region.rectangle=[0,0,16,12]") == [0, 32, 32, 32]
    assert points("region.rectangle=[0,0,16,12]", "region.enabled=false") == points()


@pytest.mark.parametrize(
    ("setting", "words"),
    [("tolerance.tt=1", "did you mean tolerance.t"), ("tolerance.t", "FIELD=VALUE"), ("tolerance.t=7", "0 to 1")],
)
def test_run_refuses_what_cannot_be_set(tactune: Tactune, recording: Path, setting: str, words: str) -> None:
    assert words in tactune("run", "-s", recording, "--json", "--set", setting).sentence
