"""``tactune preset findings``: findings in sentences, with their own exit status."""

SOURCE = "sim:cup?press=medium"


def test_a_good_preset_has_no_findings(tactune):
    finished = tactune("preset", "findings", "--source", SOURCE)
    assert (finished.status, finished.out) == (0, "no findings\n")


def test_findings_are_printed_with_what_mends_them(tactune, tmp_path):
    spoiled = tmp_path / "spoiled.json"
    words = ("preset", "new", "--from", "simulator", "--set", "alignment.depth_offset_m=0.012", "--out", spoiled)
    assert tactune(*words).status == 0
    finished = tactune("preset", "findings", "--source", SOURCE, "--preset", spoiled, "--frame", 0)
    assert finished.status == 1
    assert finished.out.startswith("alignment.depth_offset_m: Peak of the differences at −")
    assert "--set alignment.depth_offset_m=0.0" in finished.out
