"""What a command cannot do is one sentence that names it, exit status 2, and no file."""

import json
from importlib import resources
from pathlib import Path

import pytest

SETTINGS = [
    ("mask.hues=[1,2]", "mask.hue?"),
    ("mask.enabled=maybe", "maybe"),
    ("tolerance.t", "FIELD=VALUE"),
    ("mask.hue=" + "[" * 50_000, "mask.hue"),
    ("alignment.rigid.T_proximity_tactile={}", "alignment.rigid.T_proximity_tactile"),
]
REFUSED = [
    ("run --source simulator --json", "simulator"),
    ("run --source sim:cup?press= --json", "press is ''"),
    ("run --source sim --topics proximity.depth=/a", "the simulator has no option 'proximity.depth'"),
    ("run --source rosbag:OUT", "holds no recording"),
    ("run --source rosbag:/dev/null", "it is empty"),
    ("run --source IN --out=", "--out' / '-o': it is empty"),
    ("serve --source IN --unit mm", "--unit is the unit of --mesh"),
    ("serve --source IN --origin https://a.b/c", "the origin is 'https://a.b/c'"),
    ("run --source IN --preset no_such_preset --json", "no_such_preset"),
    ("run --source IN --preset IN/rig.json --json", "rig.json"),
    ("run --source IN --preset IN/000000/tactile_depth.png --json", "not a text file"),
    ("run --source IN --out /dev/null/out", "/dev/null/out"),
    ("run --source IN --out IN/rig.json", "rig.json is a file"),
    ("run --source simm", "did you mean sim"),
    ("run --source foldr:IN", "did you mean folder"),
    ("--source sim", "tactune gui --source sim"),
    (f"run --source {'x' * 5000} --json", "too long"),
    ("run --source ~nosuchuser/x --json", "nosuchuser"),
    ("run --source \x1b[2Jx --json", "[2Jx"),
    ("run --source IN --json --preset=", "Is a directory"),
    ("lab strain --source IN --csv OUT", "no ordinary file"),
    ("lab faults --sensor clean&press=low", "sensor is 'clean&press=low'"),
    ("run --source IN --watch", "no untouched frame"),
    ("check --source IN --preset default", "no untouched frame"),
    ("convert IN IN", "recording"),
    ("convert IN .", "not an empty folder"),
    ("convert OUT/none.bag OUT/a.mcap", "there is no such file"),
    ("convert sim OUT/a.bag", "--to folder"),
    ("convert sim OUT/a.mp4", "--to folder"),
    ("convert sim:cup OUT/a.yaml", "--to ros"),
    ("convert default OUT/a.urdf", "names none"),
    ("convert nowhere OUT/a.urdf", "no source"),
    ("record -s sim -o OUT/a.bag", ".mcap"),
    ("record -s sim -o OUT/a.mcap -p nowhere", "cannot read preset nowhere"),
    ("record -s IN -o IN/precious.mcap", "already there"),
    ("convert IN IN/precious.mcap", "already there"),
    ("preset new --rig IN --out IN/rig.json", "already there"),
    ("preset new --out OUT/a.json", "--rig"),
    ("preset new --from default --out OUT/a.json", "names no rig"),
    ("preset new --rig nowhere --out OUT/a.json", "nowhere"),
    ("preset capture-untouched --source IN --preset default", "default is no preset file"),
    ("preset measure-rig --source IN --out OUT/clip.mcap", "is no preset file"),
    ("preset measure-rig --source IN --out SHIPPED", "already there"),
    ("preset suggest --source IN --preset default --section mask", "capture an untouched frame"),
    ("preset suggest --source IN --frame 5", "no frame 5"),
    ("preset suggest --source IN --frame 5000", "frames run from 0 to 3"),
    *((words, "for example: tactune") for words in ("record", "convert", "calibrate", "check", "track", "run sim")),
    *((words, "--help says") for words in ("nothing", "lab nothing", "lab table --nothing", "warmup nothing")),
    ("run --source nowhere --out OUT/new", "no source"),
    ("tune", "give --source"),
    ("tune --source IN --out OUT", "no ordinary file"),
    ("preset suggest --source IN --out IN/rig.json", "already there"),
    ("preset create-rig IN --proximity L515=none", "none"),
    *((f"preset new --rig IN --out OUT/a.json --set {setting}", named) for setting, named in SETTINGS),
]


@pytest.mark.parametrize(("words", "named"), REFUSED)
def test_it_is_one_sentence_and_writes_nothing(tactune, recording, tmp_path, words, named):
    out, shipped = tmp_path / "out", Path(str(resources.files("tactune.presets"))) / "simulator.json"
    out.mkdir()
    (recording / "precious.mcap").write_text("precious")
    before = {path: path.read_bytes() for path in (*recording.rglob("*.*"), shipped) if path.is_file()}
    for place, path in (("SHIPPED", shipped), ("OUT", out), ("IN", recording)):
        words = words.replace(place, str(path))
    assert named in tactune(*words.split()).sentence
    assert list(out.iterdir()) == []
    assert {path: path.read_bytes() for path in before} == before


LONG = "\x1b[31m" + "wxyz" * 2000
POINTS = "id,enabled,proximity_u,proximity_v,tactile_u,tactile_v,tactile_depth_m\n1,1,1,1,1,"


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("run --source sim:wxyzNAME?wxyzNAME=1".replace("NAME", "wxyz" * 900), ""),
        ("preset new --out OUT --rig FILE", json.dumps({LONG: 1})),
        ("preset validate FILE", json.dumps({LONG: 1, "schema": LONG})),
        ("calibrate --rig IN --points FILE", f"{LONG},enabled\n1,1\n"),
        ("calibrate --rig IN --points FILE", f"{POINTS}{LONG},1\n"),
    ],
)
def test_a_message_prints_little_of_a_file_and_no_control_characters(tactune, recording, tmp_path, words, text):
    file = tmp_path / "\x1b[2J" / "a.json"
    file.parent.mkdir()
    file.write_text(text)
    for place, path in (("FILE", file), ("OUT", tmp_path / "out.json"), ("IN", recording)):
        words = words.replace(place, str(path))
    said = tactune(*words.split()).sentence
    assert said.strip().isprintable()
    assert said.count("wxyz") < 50
