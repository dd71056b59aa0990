import codecs

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jaxtrack.io import DataError, read_detections


def written(tmp_path, text):
    path = tmp_path / "detections.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_unequal_counts_and_an_empty_look(tmp_path):
    path = written(tmp_path, "time_s,x_m,y_m\n0,1,2\n0,3,4\n2.5,,\n4,5,6\n")
    recording = read_detections(path)
    scans = recording.scans
    assert scans.time_s.tolist() == [0.0, 2.5, 4.0]
    assert scans.mask.tolist() == [[True, True], [False, False], [True, False]]
    assert scans.position_m[0].tolist() == [[1.0, 2.0], [3.0, 4.0]]
    assert scans.position_m[2].tolist() == [[5.0, 6.0], [0.0, 0.0]]
    assert scans.valid.all()
    assert (scans.weight, scans.covariance_m2, scans.delay_s) == (None, None, None)
    assert recording.axes == "x_y"


def test_unix_time_and_utm(tmp_path):
    path = written(
        tmp_path,
        "time_s,x_m,y_m\n1700000000.25,565432.123,5934567.891\n1700000001.75,565433.5,5934569\n",
    )
    recording = read_detections(path)
    assert recording.epoch_s == 1700000000.25
    assert recording.origin_m.tolist() == [565000.0, 5935000.0]
    near_m = recording.scans.position_m.astype(np.float32).astype(np.float64)[:, 0]
    far_m = near_m + recording.origin_m
    np.testing.assert_allclose(
        far_m, [[565432.123, 5934567.891], [565433.5, 5934569.0]], rtol=0, atol=1e-3
    )
    assert recording.scans.time_s.tolist() == [0.0, 1.5]


def test_cardinal_bearings_in_both_conventions(tmp_path):
    path = written(
        tmp_path, "time_s,range_m,bearing_deg\n0,100,0\n1,100,90\n2,100,180\n3,100,270\n"
    )
    compass = read_detections(path)
    expected_m = [[100.0, 0.0], [0.0, 100.0], [-100.0, 0.0], [0.0, -100.0]]
    np.testing.assert_allclose(compass.scans.position_m[:, 0], expected_m, atol=1e-9)
    mathematical = read_detections(path, bearing="math")
    np.testing.assert_allclose(mathematical.scans.position_m[:, 0], expected_m, atol=1e-9)
    assert (compass.axes, mathematical.axes) == ("north_east", "x_y")


def test_own_ship_and_polar_sigmas(tmp_path):
    path = written(
        tmp_path,
        "time_s,range_m,bearing_deg,own_x_m,own_y_m,own_heading_deg,sigma_range_m,"
        "sigma_bearing_deg,weight\n0,50,90,1000,2000,90,2,1,0.5\n1,,,1000,2000,90,,,\n",
    )
    scans = read_detections(path).scans
    # Heading east and 90° to starboard is south: the range lies along x, north.
    np.testing.assert_allclose(scans.position_m[0, 0], [950.0, 2000.0], atol=1e-9)
    across_m2 = (50.0 * np.pi / 180.0) ** 2
    np.testing.assert_allclose(
        scans.covariance_m2[0, 0], [[4.0, 0.0], [0.0, across_m2]], atol=1e-12
    )
    assert scans.weight.tolist() == [[0.5], [0.0]]
    assert scans.mask.tolist() == [[True], [False]]


def test_covariance_columns_and_one_sigma(tmp_path):
    header = "time_s,x_m,y_m,cov_xx_m2,cov_xy_m2,cov_yy_m2\n"
    scans = read_detections(written(tmp_path, header + "0,1,2,4,-1,9\n")).scans
    assert scans.covariance_m2.tolist() == [[[[4.0, -1.0], [-1.0, 9.0]]]]
    scans = read_detections(written(tmp_path, "time_s,x_m,y_m,sigma_m\n0,1,2,3\n")).scans
    assert scans.covariance_m2.tolist() == [[[[9.0, 0.0], [0.0, 9.0]]]]


def test_scan_numbers_delays_and_gaps(tmp_path):
    path = written(
        tmp_path, "scan,time_s,x_m,y_m\n3,10,,\n3,10.5,1,2\n3,10.2,3,4\n5,14,5,6\n6,16,,\n"
    )
    scans = read_detections(path, epoch_s=0.0).scans
    assert scans.time_s.tolist() == [10.0, 12.0, 14.0, 16.0]
    assert scans.mask.sum(axis=1).tolist() == [2, 0, 1, 0]
    np.testing.assert_allclose(scans.delay_s[0], [0.5, 0.2], atol=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        codecs.BOM_UTF8 + b"time_s,x_m,y_m\n0,1,2\n1,3,4\n",
        b"time_s,x_m,y_m\r\n0,1,2\r\n1,3,4\r\n",
        codecs.BOM_UTF8 + b"time_s;x_m;y_m\r\n0;1;2\r\n1;3;4",
        b"time_s\tx_m\ty_m\n0\t1\t2\n1\t3\t4\n",
        b" Y_M , Time_S,X_m \n 2,0 ,1\n\n4,1,3\n,,\n\n",
        b'"time_s","x_m","y_m"\r0,"1",2\r1,3,4\r',
    ],
    ids=["bom", "crlf", "semicolon", "tab", "order and blanks", "quotes and cr"],
)
def test_dialects_read_the_same(tmp_path, text):
    scans = read_detections(written(tmp_path, text)).scans
    assert scans.time_s.tolist() == [0.0, 1.0]
    assert scans.position_m.tolist() == [[[1.0, 2.0]], [[3.0, 4.0]]]


def test_one_scan_only_and_zero_detections(tmp_path):
    one = read_detections(written(tmp_path, "time_s,x_m,y_m\n7,1,2\n")).scans
    assert one.mask.tolist() == [[True]]
    recording = read_detections(written(tmp_path, "time_s,x_m,y_m,sigma_m\n7,,,\n8,,,\n"))
    assert recording.scans.mask.tolist() == [[False], [False]]
    assert recording.scans.covariance_m2.shape == (2, 1, 2, 2)
    assert recording.origin_m.tolist() == [0.0, 0.0]
    assert np.isfinite(recording.scans.position_m).all()


def test_width_can_be_shared(tmp_path):
    path = written(tmp_path, "time_s,x_m,y_m\n0,1,2\n0,1,2\n")
    assert read_detections(path, max_detections=5).scans.mask.shape == (1, 5)
    with pytest.raises(ValueError, match="max_detections: got 1, want at least 2"):
        read_detections(path, max_detections=1)


CARTESIAN = "time_s,x_m,y_m"
POLAR = "time_s,range_m,bearing_deg"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", r": got an empty file, want a header and rows"),
        (codecs.BOM_UTF8 + b"\r\n \r\n", r": got an empty file"),
        (f"{CARTESIAN}\n\n", r": got a header and no rows"),
        (b"time_s,x_m,y_m\n0,\xff,1\n", r", row 2: got bytes that are not UTF-8"),
        ("time_s,x_m,y_m\n0,1,2\n".encode("utf-16"), r", row 1: got bytes that are not UTF-8"),
        ("x_m,y_m\n1,2\n", r": got columns x_m, y_m, want column time_s"),
        ("time_s,x_m\n0,1\n", r": got columns time_s, x_m, want column y_m"),
        ("time_s,range_m\n0,1\n", r"want column bearing_deg"),
        ("time_s\n0\n", r"want column x_m \(or range_m, bearing_deg\)"),
        ("time_s,x_m,y_m,range_m,bearing_deg\n0,1,2,3,4\n", r"got columns of both"),
        (f"{CARTESIAN},wieght\n0,1,2,1\n", r"column 'wieght': got an unknown.*scan, weight, x_m"),
        (f"{CARTESIAN},own_x_m\n0,1,2,1\n", r"column 'own_x_m': got an unknown column"),
        (f"{CARTESIAN},\n0,1,2,\n", r"column '': got an unknown column"),
        (f"{CARTESIAN},X_m\n0,1,2,3\n", r"row 1, column 'x_m': got it twice in the header"),
        (f"{CARTESIAN},cov_xx_m2\n0,1,2,1\n", r"want cov_xy_m2, cov_yy_m2 too"),
        (f"{POLAR},sigma_range_m\n0,1,2,1\n", r"want sigma_bearing_deg too"),
        (f"{POLAR},own_y_m\n0,1,2,1\n", r"want own_x_m too"),
        (f"{CARTESIAN},cov_xx_m2,cov_xy_m2,cov_yy_m2,sigma_m\n0,1,2,1,0,1,1\n", r"'sigma_m'.*one"),
        (f"{CARTESIAN}\n0,1,2\n1,2\n", r", row 3, column y_m: got 2 cells, want 3"),
        (f"{CARTESIAN}\n0,1,2,3\n", r", row 2, column y_m: got 4 cells, want 3"),
        (f"{CARTESIAN}\n0,1,2\n\n1,nan,2\n", r", row 4, column x_m: got nan, want a finite"),
        (f"{CARTESIAN}\n0,1,2\n1,2,-inf\n", r", row 3, column y_m: got -inf, want a finite"),
        (f"{CARTESIAN}\n0,1,1e400\n", r", row 2, column y_m: got inf"),
        (f"{CARTESIAN}\nnan,1,2\n", r", row 2, column time_s: got nan"),
        (f"{CARTESIAN}\n0,one,2\n", r", row 2, column x_m: got 'one', want a number"),
        ("time_s;x_m;y_m\n0;1,5;2\n", r"column x_m: got '1,5', want a number with a decimal point"),
        (f"{CARTESIAN}\n,1,2\n", r", row 2, column time_s: got an empty cell, want a number"),
        (f"{CARTESIAN}\n0,1,\n", r", row 2, column y_m: got an empty cell, want a number"),
        (f"{CARTESIAN},weight\n0,1,2,\n", r", row 2, column weight: got an empty cell"),
        (f"{CARTESIAN}\r\n1,1,2\r\n0.5,1,2\r\n", r", row 3, column time_s: got 0.5 after 1, want"),
        (f"{CARTESIAN},scan\n0,,,2\n1,,,1\n", r", row 3, column scan: got 1 after 2, want"),
        (f"{CARTESIAN},scan\n1,,,1\n2,,,1\n.5,,,2\n", r", row 4, column time_s: got 0.5 after 1"),
        (f"{CARTESIAN},scan\n1,,,1.5\n", r", row 2, column scan: got 1.5, want a whole number"),
        (f"{CARTESIAN},scan\n1,,,1\n2,,,9999\n", r", row 3, column scan: got 9999 after 1, want"),
        (
            f"{CARTESIAN},sigma_m\n0,,,\n0,1,2,-1\n",
            r", row 3, column sigma_m: got -1, want a stand",
        ),
        (f"{CARTESIAN},sigma_m\n0,1,2,0\n", r", row 2, column sigma_m: got 0, want a standard"),
        (
            f"{POLAR},sigma_range_m,sigma_bearing_deg\n0,1,2,1,-2\n",
            r"column sigma_bearing_deg: got -2",
        ),
        (f"{POLAR}\n0,0,2\n", r", row 2, column range_m: got 0, want a positive range"),
        (f"{POLAR}\n0,-3,2\n", r", row 2, column range_m: got -3, want a positive range"),
        (
            f"{CARTESIAN},weight\n0,1,2,1.01\n",
            r", row 2, column weight: got 1.01, want a weight in",
        ),
        (
            f"{CARTESIAN},cov_xx_m2,cov_xy_m2,cov_yy_m2\n0,1,2,4,6,9\n",
            r", row 2, column cov_xy_m2: got 6, want",
        ),
        (
            f"{CARTESIAN},cov_xx_m2,cov_xy_m2,cov_yy_m2\n0,1,2,4,0,-9\n",
            r", row 2, column cov_yy_m2: got -9, want a variance",
        ),
    ],
)
def test_wrong_files_are_named_with_row_and_column(tmp_path, text, words):
    path = written(tmp_path, text)
    with pytest.raises(DataError, match=words) as caught:
        read_detections(path)
    assert str(caught.value).startswith(str(path))


def test_an_endless_cell_is_an_error(tmp_path):
    path = written(tmp_path, "time_s,x_m,y_m\n0,1," + "1" * 200_000 + "\n")
    with pytest.raises(DataError, match="row 2: field larger than field limit"):
        read_detections(path)


def test_separators_alone_are_no_table(tmp_path):
    with pytest.raises(DataError, match=r"detections\.csv: got nothing but separators"):
        read_detections(written(tmp_path, ",,,\n,,\n"))


def test_a_quotation_mark_that_is_never_closed(tmp_path):
    path = written(tmp_path, 'time_s,x_m,y_m\n0,1,2\n1,"3,4\n2,5,6\n')
    with pytest.raises(DataError, match=r"row 4: a quotation mark is never closed"):
        read_detections(path)


def test_a_missing_file_and_an_unknown_convention(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_detections(tmp_path / "nothing.csv")
    with pytest.raises(ValueError, match="bearing: got 'north', want one of"):
        read_detections(tmp_path / "nothing.csv", bearing="north")


@settings(deadline=None, max_examples=60)
@given(data=st.data())
def test_what_is_written_is_read(tmp_path_factory, data):
    counts = data.draw(st.lists(st.integers(0, 3), min_size=1, max_size=6))
    coordinate = st.floats(-1e7, 1e7)
    lines, looks = ["time_s,x_m,y_m,weight"], []
    for index, count in enumerate(counts):
        time_s = 1.7e9 + 0.7 * index
        rows = [(data.draw(coordinate), data.draw(coordinate), 0.25) for _ in range(count)]
        lines += [f"{time_s!r},{x!r},{y!r},{w!r}" for x, y, w in rows] or [f"{time_s!r},,,"]
        looks.append(rows)
    path = tmp_path_factory.mktemp("round_trip") / "detections.csv"
    path.write_text("\n".join(lines))
    recording = read_detections(path)
    scans = recording.scans
    assert scans.mask.sum(axis=1).tolist() == counts
    for index, rows in enumerate(looks):
        mask = scans.mask[index]
        expected_m = np.array([row[:2] for row in rows]).reshape(-1, 2)
        got_m = scans.position_m[index][mask] + recording.origin_m
        np.testing.assert_allclose(got_m, expected_m, rtol=0, atol=1e-8)
        assert (scans.weight[index][mask] == 0.25).all()
        assert scans.time_s[index] + recording.epoch_s == pytest.approx(
            1.7e9 + 0.7 * index, abs=1e-6
        )
