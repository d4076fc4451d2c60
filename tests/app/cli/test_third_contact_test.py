"""Adding a contact test needs one file and one line; tested in a copy of the program."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
TOY = Path(__file__).with_name("toy_contact_test.py")
LINE = '    "tolerance": ToleranceTest,\n'

PANEL = """
import sys
from PyQt6.QtWidgets import QApplication
from tactune.core.preset import Preset
from tactune.widgets.parameters.parameter_panel import ParameterPanel
application = QApplication([])
panel = ParameterPanel()
panel.set_preset(Preset(contact_test="toy"))
print([name for name, section in panel.sections.items() if not section.isHidden()])
print(panel.rows["toy.limit_m"].editor.value())
"""

#: Commands one after the other; a line "=" ends what each prints.
COMMANDS = """
import json, sys
from tactune.app.cli.main import main
for words in json.loads(sys.argv[1]):
    sys.argv = ["tactune", *words]
    assert main() == 0, words
    print("=")
"""


@pytest.fixture
def program(tmp_path):
    """Return a folder with the program, in which the toy's file and line have been added."""
    package = tmp_path / "program" / "tactune"
    for folder in ("app", "widgets", "presets", "core"):
        (package / folder).mkdir(parents=True)
        for entry in (ROOT / folder).iterdir():
            if entry.name != "__pycache__" and entry != ROOT / "core" / "contact":
                (package / folder / entry.name).symlink_to(entry)
    contact = package / "core" / "contact"
    contact.mkdir()
    for entry in (ROOT / "core" / "contact").iterdir():
        if entry.is_dir():
            (contact / entry.name).symlink_to(entry)  # so that compiled kernels are found
        else:
            shutil.copy(entry, contact)
    shutil.copy(TOY, contact / "toy.py")
    registry = contact / "__init__.py"
    text = registry.read_text()
    assert text.count(LINE) == 1
    text = text.replace("from .tolerance", "from .toy import ToyTest\nfrom .tolerance")
    registry.write_text(text.replace(LINE, LINE + '    "toy": ToyTest,\n'))
    return tmp_path / "program"


def python(program, *words):
    environment = os.environ | {"PYTHONPATH": str(program), "QT_QPA_PLATFORM": "offscreen"}
    done = subprocess.run(
        [sys.executable, *words], check=False, capture_output=True, text=True, env=environment, cwd=program
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_third_contact_test_is_one_file_and_one_line(program, recording, tmp_path):
    preset, rig = str(tmp_path / "toy.json"), str(recording / "rig.json")
    schema, _, frames, _ = python(program, "-c", COMMANDS, json.dumps([
        ["preset", "schema"],
        ["preset", "new", "--rig", rig, "--out", preset, "--set", "toy.limit_m=0.02"],
        ["run", "-s", str(recording), "-p", preset, "--json"],
    ])).split("=\n")  # fmt: skip
    contact_test = json.loads(schema)["properties"]["contact_test"]
    assert contact_test["enum"] == ["membrane", "tolerance", "toy", "dent", "pressure"]
    assert "toy: both depths differ" in contact_test["description"]
    assert json.loads(Path(preset).read_text())["contact_test"] == "toy"
    found = [json.loads(frame) for frame in frames.splitlines()]
    assert set(found[0]["stage_ms"]) == {"compare", "border"}
    assert max(frame["points"] for frame in found) > 0

    shown = python(program, "-c", PANEL).splitlines()
    assert shown[0] == "['alignment', 'mask', 'contact_test', 'toy', 'range', 'region']"
    assert shown[1] == "0.005"
