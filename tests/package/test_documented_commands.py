"""Every ``tactune`` command in README and guide is accepted as written, and Python examples run."""

import re
import runpy
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import typer

from tactune.app.cli.main import commands

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs" / "guide").glob("*.md"))]


def documented_commands():
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


def parse(words):
    """Parse a command line without running it; names of commands alone need no options."""
    command = typer.main.get_command(commands)
    name, rest, parent = "tactune", words, None
    while rest:
        context = command.make_context(name, list(rest), parent=parent)
        left = [*getattr(context, "_protected_args", ()), *context.args]
        if not left or not hasattr(command, "resolve_command"):
            return
        name, command, rest = command.resolve_command(context, left)
        parent = context


@pytest.mark.parametrize(("page", "command"), documented_commands())
def test_a_documented_command_is_accepted(page, command):
    parse(shlex.split(command)[1:])


def test_pages_name_each_other_truly():
    for page in [*PAGES, *(ROOT / "docs").glob("*.md")]:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text("utf-8")):
            assert (page.parent / target).exists(), f"{page.name} names {target}"


def test_the_guide_builds_without_a_warning_and_reads_without_a_network(tmp_path):
    """``strict`` in mkdocs.yml fails on links, anchors and pictures that lead nowhere, and on pages left out."""
    built = tmp_path / "guide"
    command = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--config-file", str(ROOT / "docs" / "mkdocs.yml")]
    done = subprocess.run([*command, "--site-dir", str(built)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    pages = {page.stem for page in (ROOT / "docs" / "guide").glob("*.md")}
    assert {page.stem for page in built.glob("*.html")} == pages | {"404"}
    assert "membrane" in (built / "search" / "search_index.js").read_text("utf-8"), "file:// pages search this"
    for page in built.glob("*.html"):
        loaded = re.findall(r"<(?:script|img|link)[^>]+(?:src|href)=\"?(https?:[^\" >]+)", page.read_text("utf-8"))
        assert [url for url in loaded if "canonical" not in url] == [], page.name


def test_the_page_of_keys_is_that_of_the_window():
    words = runpy.run_path(str(ROOT / "scripts" / "make_keys.py"))["page"]()
    assert (ROOT / "docs" / "guide" / "keys.md").read_text("utf-8") == words, "run scripts/make_keys.py"
