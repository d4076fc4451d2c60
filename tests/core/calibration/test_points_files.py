import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tactune.core.calibration.points import read_points, write_points
from tactune.core.errors import CalibrationError
from tactune.core.model.alignment import PointPair

HEADER = "id,enabled,proximity_u,proximity_v,tactile_u,tactile_v,tactile_depth_m"
pixel = st.floats(-1e6, 1e6)
pairs = st.lists(
    st.builds(
        PointPair,
        id=st.text("abc 1,\"'é", min_size=1, max_size=8).filter(lambda text: text == text.strip()),
        proximity_u=pixel,
        proximity_v=pixel,
        tactile_u=pixel,
        tactile_v=pixel,
        tactile_depth_m=st.none() | st.floats(1e-3, 10),
        enabled=st.booleans(),
        proximity_image=st.sampled_from(["depth", "color"]),
        snapshot=st.none() | st.integers(0, 99),
    ),
    unique_by=lambda pair: pair.id,
)


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(pairs)
def test_pairs_survive_csv_bit_for_bit(tmp_path, points):
    write_points(tmp_path / "a.csv", points)
    assert read_points(tmp_path / "a.csv") == points


def test_plain_pairs_are_written_with_the_plain_header(tmp_path):
    text = f"{HEADER}\n1,1,1.5,2.0,3.0,4.0,0.3\n2,0,1.0,2.0,3.0,5.0,\n"
    (tmp_path / "given.csv").write_text(text)
    points = read_points(tmp_path / "given.csv")
    assert [(pair.id, pair.enabled, pair.tactile_depth_m) for pair in points] == [("1", True, 0.3), ("2", False, None)]
    write_points(tmp_path / "points.csv", points)
    assert (tmp_path / "points.csv").read_text() == text


def test_four_columns_are_enough(tmp_path):
    (tmp_path / "four.csv").write_text("tactile_u,tactile_v,proximity_u,proximity_v\n1,2,3,4\n\n5,6,7,8\n")
    pixels = {"tactile_u": 5, "tactile_v": 6, "proximity_u": 7, "proximity_v": 8}
    assert read_points(tmp_path / "four.csv")[1] == PointPair(id="2", **pixels)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "lacks the column proximity_u"),
        ("a,b\n1,2\n", "lacks the column proximity_u"),
        (f"{HEADER},colour\n", "column 'colour'"),
        (f"{HEADER}\n1,1,2,3,4,5\n", "line 2: there are not 7 values"),
        (f"{HEADER}\n1,1,2,3,4,5,0.3\n1,1,2,3,4,6,0.3\n", "line 3: id '1' is taken"),
        (f"{HEADER}\n1,1,2,x,4,5,0.3\n", "line 2: proximity_v is 'x'"),
        (f"{HEADER}\n1,1,2,inf,4,5,0.3\n", "line 2: proximity_v is 'inf'"),
        (f"{HEADER}\n1,maybe,2,3,4,5,0.3\n", "line 2: enabled is 'maybe'"),
        (f"{HEADER}\n1,1,2,3,4,5,-0.3\n", "line 2: tactile_depth_m is '-0.3'"),
        (f"{HEADER}\n1,1,2,3,4,5,295\n", "line 2: tactile_depth_m is '295'"),
        (f"{HEADER}\n,1,2,3,4,5,0.3\n", "line 2: id has no value"),
        (f"{HEADER},proximity_image\n1,1,2,3,4,5,0.3,infrared\n", "line 2: proximity_image is 'infrared'"),
        (f'{HEADER}\n1,1,"2,3,4,5,0.3\n', "not CSV"),
    ],
)
def test_a_bad_row_is_named_with_line_field_and_value(tmp_path, text, words):
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(CalibrationError, match=words) as caught:
        read_points(tmp_path / "bad.csv")
    assert "bad.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


TABLE = [HEADER.split(","), ["1", "1", "1.5", "2", "3", "4", "0.25"], ["a b", "0", "-1.5", "2", "3", "5", ""]]


def joined(separator, rows=TABLE, end="\n"):
    return end.join(separator.join(row) for row in rows) + end


SPREADSHEETS = {
    "semicolon": joined(";").encode(),
    "decimal comma": joined(";").replace(".", ",").encode(),
    "tab": joined("\t").replace(".", ",").encode(),
    "quoted": joined(",", [[f'"{cell}"' for cell in row] for row in TABLE]).encode(),
    "quoted decimal comma": joined(",", [[f'"{cell}"' for cell in row] for row in TABLE]).replace(".", ",").encode(),
    "byte order mark, CRLF": b"\xef\xbb\xbf" + joined(";", end="\r\n").encode(),
    "Unicode text of Excel": joined("\t").encode("utf-16"),
    "upper case in another order": joined(",", [row[::-1] for row in TABLE]).replace("_u", "_U").encode(),
    "blank lines and cells": ("\n\n" + joined(";").replace("\n", ";;\n") + ";;;\n\n").encode(),
    "sep=": b"sep=;\r\n" + joined(";", end="\r\n").encode(),
    "TRUE and FALSE": joined(";").replace(";1;1.5", ";TRUE;1.5").replace("b;0", "b;FALSE").encode(),
    "spaces": joined(", ").encode(),
    "exponents": joined(";").replace("1.5", "1,5E+00").replace("0.25", "2,5E-01").encode(),
}


@pytest.mark.parametrize("kind", SPREADSHEETS)
def test_a_table_of_any_spreadsheet_has_the_same_pairs(tmp_path, kind):
    (tmp_path / "a.csv").write_bytes(SPREADSHEETS[kind])
    first, second = read_points(tmp_path / "a.csv")
    assert (first.id, first.enabled, first.proximity_u, first.tactile_depth_m) == ("1", True, 1.5, 0.25)
    assert (second.id, second.enabled, second.proximity_u, second.tactile_depth_m) == ("a b", False, -1.5, None)


def test_a_comma_in_a_file_of_points_is_not_guessed(tmp_path):
    (tmp_path / "a.csv").write_text(joined(";").replace("-1.5", "1,234"))
    with pytest.raises(CalibrationError, match="line 3: proximity_u is '1,234'"):
        read_points(tmp_path / "a.csv")
