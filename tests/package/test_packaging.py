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


@pytest.mark.parametrize("python", ["3.11", "3.12", "3.13"])
def test_the_lock_holds_what_pyproject_allows(pyproject, python):
    environment = {"python_version": python, "python_full_version": f"{python}.1"}
    environment |= {"sys_platform": "linux", "platform_machine": "x86_64"}

    def holds(requirement):
        return not requirement.marker or requirement.marker.evaluate(environment)

    lines = re.findall(r"^([a-z0-9-]+==[^\\\n]+)", (ROOT / "requirements.lock").read_text(), re.MULTILINE)
    found = [it for it in map(Requirement, lines) if holds(it)]
    locked = {it.name: str(it.specifier).removeprefix("==") for it in found}
    assert len(locked) == len(found)
    project = pyproject["project"]
    wanted = [
        *project["dependencies"],
        *(line for extra in project["optional-dependencies"].values() for line in extra),
    ]
    for requirement in map(Requirement, wanted):
        if requirement.name != project["name"] and holds(requirement):
            assert requirement.specifier.contains(locked[canonicalize_name(requirement.name)]), str(requirement)
