"""pyproject.toml agrees with the folders and with the lock file."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("core", "widgets", "app", "presets")


@pytest.fixture(scope="module")
def pyproject():
    return tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_every_folder_with_code_is_a_package_and_listed(pyproject):
    with_code = {file.parent.relative_to(ROOT) for name in FOLDERS for file in (ROOT / name).rglob("*.py")}
    listed = pyproject["tool"]["setuptools"]["packages"]
    assert sorted(listed) == sorted(".".join(("tactune", *folder.parts)) for folder in with_code)
    assert [folder for folder in with_code if not (ROOT / folder / "__init__.py").is_file()] == []


def test_the_lock_holds_what_pyproject_allows(pyproject):
    locked = dict(re.findall(r"^([a-z0-9-]+)==(\S+)", (ROOT / "requirements.lock").read_text(), re.MULTILINE))
    project = pyproject["project"]
    wanted = [
        *project["dependencies"],
        *(line for extra in project["optional-dependencies"].values() for line in extra),
    ]
    environment = {"python_version": "3.11", "sys_platform": "linux", "platform_machine": "x86_64"}
    for requirement in map(Requirement, wanted):
        if requirement.name != project["name"] and (not requirement.marker or requirement.marker.evaluate(environment)):
            assert requirement.specifier.contains(locked[canonicalize_name(requirement.name)]), str(requirement)
