"""Every ``tactune`` command in README and guide is accepted as written, and Python examples run."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import typer

from tactune.app.cli.main import commands

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs" / "guide").glob("*.md"))]


def documented_commands() -> list[tuple[str, str]]:
    """Return (page, command) of code blocks and inline code; inline code may be broken over two lines."""
    found = []
    for page in PAGES:
        in_block, prose = False, []
        for line in page.read_text("utf-8").splitlines():
            if line.startswith("```"):
                in_block = not in_block
            elif not in_block:
                prose.append(line)
            elif line.startswith("tactune "):
                found.append((page.name, line))
        found += [
            (page.name, " ".join(code.split())) for code in re.findall(r"`(tactune\b(?!\.)[^`]*)`", "\n".join(prose))
        ]
    return list(dict.fromkeys(found))


def parse(words: list[str]) -> None:
    """Parse a command line without running it; names of commands alone need no options."""
    command: Any = typer.main.get_command(commands)
    name, rest, parent = "tactune", words, None
    while rest:
        context = command.make_context(name, list(rest), parent=parent)
        left = [*getattr(context, "_protected_args", ()), *context.args]
        if not left or not hasattr(command, "resolve_command"):
            return
        name, command, rest = command.resolve_command(context, left)
        parent = context


@pytest.mark.parametrize(("page", "command"), documented_commands())
def test_a_documented_command_is_accepted(page: str, command: str) -> None:
    parse(shlex.split(command)[1:])


def test_a_wrong_command_is_noticed() -> None:
    for words in (["rum"], ["run", "--sauce", "sim"], ["preset", "mew", "--out", "x.json"]):
        with pytest.raises(Exception, match=r"(?i)no such"):
            parse(words)


def test_pages_name_each_other_truly() -> None:
    for page in [*PAGES, *(ROOT / "docs").glob("*.md")]:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text("utf-8")):
            assert (page.parent / target).exists(), f"{page.name} names {target}"


def test_scripts_that_the_pages_name_exist() -> None:
    for page in [*PAGES, *(ROOT / "docs").glob("*.md")]:
        for script in re.findall(r"scripts/\w+\.py", page.read_text("utf-8")):
            assert (ROOT / script).is_file(), f"{page.name} names {script}"
