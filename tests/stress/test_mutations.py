"""Thousands of damaged files, seeds fixed: each is read or refused in a sentence, in little memory and time."""

import os
import random
import re

import pytest

from attacks import bounded, damaged
from kinds import KINDS
from tactune.core.errors import TactuneError

pytestmark = pytest.mark.long

#: Values that are put in place of a value of a JSON, CSV or text file.
VALUES = (
    *("null", "[]", "{}", '""', '"x"', "true", "-1", "0", "1e300", "-1e300", "NaN", "Infinity", "1" * 400, "0.5"),
    *("[[[[]]]]", "9223372036854775808", '"\\u0000"', '"../../x"', "[1e999]", "[" * 100_000 + "]" * 100_000),
    *(f'"\\u001b[31m{"wxyz" * 2000}"', f"\x1b[31m{'wxyz ' * 2000}"),
)


def mutated(whole, rng):
    """Return a file with random bytes changed, or where it is text, with one or two values replaced."""
    if whole.isascii() and rng.random() < 0.7:
        content = whole.decode()
        for _ in range(rng.choice([1, 1, 2])):
            places = list(re.finditer(r'"[^"\n]*"|-?[0-9.][0-9.e+-]*|true|false|null', content))
            place = rng.choice(places)
            content = content[: place.start()] + rng.choice(VALUES) + content[place.end() :]
        return content.encode()
    return damaged(whole, rng)


def is_read(read, folder, what):
    """Return whether a folder is read; where it is refused in words, they are one sentence."""
    try:
        return read(folder) is not False
    except TactuneError as error:
        assert str(error).isprintable(), what
        assert str(error).count("wxyz") < 100, f"{what}: a message prints the whole value"
        return False
    except Exception as error:
        raise AssertionError(f"{what}: {type(error).__name__}: {error}") from error


READ = [name for name, kind in KINDS.items() if kind.read is not None and kind.damaged]


@pytest.mark.parametrize("put", ["pipe", "endless", "folder", "loop"])
@pytest.mark.parametrize("name", READ)
def test_what_is_no_ordinary_file_is_refused(name, put, tmp_path, qapp):
    kind = KINDS[name]
    assert kind.read is not None
    kind.write(tmp_path, 0)
    for file in [path for path in tmp_path.rglob("*") if path.is_file()]:
        whole = file.read_bytes()
        file.unlink()
        if put == "pipe":
            os.mkfifo(file)
        elif put == "folder":
            file.mkdir()
        else:
            file.symlink_to("/dev/zero" if put == "endless" else file)
        with bounded(0):
            is_read(kind.read, tmp_path, file.name)
        if file.is_dir():
            file.rmdir()
        file.unlink(missing_ok=True)
        file.write_bytes(whole)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", READ)
def test_damaged_files_are_read_or_refused_and_kept(name, tmp_path, qapp, capfd):
    kind = KINDS[name]
    assert kind.read is not None
    folder = tmp_path / "a" / "b"  # so that ../../x is seen
    folder.mkdir(parents=True)
    kind.write(folder, 0)
    assert is_read(kind.read, folder, "undamaged")
    wholes = {file: file.read_bytes() for file in sorted(tmp_path.rglob("*")) if file.is_file()}
    refused = 0
    for seed in range(kind.damaged):
        rng = random.Random(f"{name} {seed}")
        file = rng.choice(list(wholes))
        bad = mutated(wholes[file], rng)
        file.write_bytes(bad)
        with bounded(sum(map(len, wholes.values()))):
            refused += not is_read(kind.read, folder, f"{file.name}, seed {seed}")
        left = {other: other.read_bytes() for other in tmp_path.rglob("*") if other.is_file()}
        assert name == "search" or bad in left.values(), f"seed {seed}: a person's file is gone"
        assert kind.keeps_state or left.keys() == wholes.keys(), f"seed {seed}: something was written"
        assert all(other.parent == folder or other in wholes for other in left), f"seed {seed}: outside the folder"
        for other in left.keys() - wholes.keys():
            other.unlink()
        for other, whole in wholes.items():
            other.write_bytes(whole)
    assert refused > kind.damaged // 25  # a recording plays up to its damage
    assert capfd.readouterr().err == "", "a library writes to the terminal"
