"""pyproject.toml agrees with the folders and the lock file; the wheel without extras runs headless.

The wheel is built and installed by pip into an empty virtual environment. Its dependencies are not downloaded:
the installed distributions that the wheel's metadata requires, without extras, are linked into a folder on the path of
the empty environment. The test is therefore quick and works offline, and packages that the wheel does not require (Qt,
OpenGL, Open3D) cannot be imported.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from importlib.metadata import Distribution, distribution
from pathlib import Path

import numpy as np
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


SOURCES = [
    "core",
    "widgets",
    "app",
    "presets",
    "docs",
    "pyproject.toml",
    "setup.py",
    "MANIFEST.in",
    "README.md",
    "LICENSE",
]


def needed_by(requirements):
    """Return every installed distribution that the requirements need, directly or not."""
    found = {}
    waiting = [Requirement(text) for text in requirements]
    while waiting:
        requirement = waiting.pop()
        name = canonicalize_name(requirement.name)
        extras = requirement.extras or {""}
        if requirement.marker and not any(requirement.marker.evaluate({"extra": extra}) for extra in ("", *extras)):
            continue
        if name not in found:
            found[name] = distribution(name)
            inner = [Requirement(text) for text in found[name].requires or []]
            waiting += [r for r in inner if not r.marker or any(r.marker.evaluate({"extra": e}) for e in extras)]
    return found


def link(found, folder):
    """Link what belongs to the distributions, and nothing else, into a folder."""
    folder.mkdir()
    for installed in found.values():
        tops = {file.parts[0] for file in installed.files or [] if file.parts[0] not in ("..", "__pycache__")}
        for top in tops:
            target = folder / top
            if not target.exists():
                target.symlink_to(Path(str(installed.locate_file(top))))


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    """Build the wheel, install it without extras into an empty environment, return that environment's bin."""
    folder = tmp_path_factory.mktemp("robot")
    source = folder / "source"
    source.mkdir()
    for name in SOURCES:
        path = ROOT / name
        if path.is_dir():
            shutil.copytree(path, source / name, ignore=shutil.ignore_patterns("__pycache__", "guide.*", "site"))
        else:
            shutil.copy(path, source / name)
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(source)]
    subprocess.run(build, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    return environment_with(wheel, folder / "environment")


def environment_with(wheel, environment):
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(environment)], check=True)
    python = environment / "bin" / "python"
    site = next((environment / "lib").glob("python*/site-packages"))
    assert not list(site.iterdir())
    install = [sys.executable, "-m", "pip", "--python", str(python), "install", "--no-deps", "--no-index", str(wheel)]
    subprocess.run(install, check=True, capture_output=True)
    (metadata,) = site.glob("tactune-*.dist-info")
    asked_for = Distribution.at(metadata).requires or []
    found = needed_by([text for text in asked_for if "extra ==" not in text])
    link(found, environment / "dependencies")
    (site / "dependencies.pth").write_text(f"{environment / 'dependencies'}\n")
    take_kernels(site / "tactune" / "core")
    return environment / "bin"


def take_kernels(core):
    """Take the kernels that the repository has compiled from the same sources: compiling them takes a minute or two."""
    for source in (ROOT / "core").rglob("*.py"):
        installed, stat = core / source.relative_to(ROOT / "core"), source.stat()
        assert installed.read_bytes() == source.read_bytes()
        os.utime(installed, ns=(stat.st_atime_ns, stat.st_mtime_ns))  # numba compares it
    for kernel in (ROOT / "core").rglob("*.nb[ci]"):
        target = core / kernel.relative_to(ROOT / "core")
        target.parent.mkdir(exist_ok=True)
        shutil.copy(kernel, target)


def test_the_wheel_holds_the_guide(robot):
    (page,) = robot.parent.glob("lib/python*/site-packages/tactune/app/guide/index.html")
    assert "membrane" in page.read_text("utf-8")


def test_the_headless_job_runs_there(robot, tmp_path):
    words = f"run --source sim --preset simulator --frames 3 --out {tmp_path} --json".split()
    done = subprocess.run([robot / "tactune", *words], check=False, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    assert [line["sequence"] for line in lines] == [0, 1, 2]
    for line in lines:
        with np.load(tmp_path / f"patch_{line['sequence']:06d}.npz") as saved:
            assert saved["points"].shape == (line["points"], 3)
