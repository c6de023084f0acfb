"""Damaged captures: a sentence with file, line, column, value and remedy, and nothing else."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from tests.capture import text_samples as samples
from tests.damage import damage
from usdface.capture import text_table
from usdface.capture.marker_take import MAX_COORDINATE_MM, CaptureOptions
from usdface.capture.sniff import FORMATS, read_capture
from usdface.core.errors import InputError

READERS = {known.name: known.read for known in FORMATS}
REMEDY = (
    "; (export|save|run|copy|choose|correct|delete|split|give|rename|add|film|wait|say)|: (exp|del)"
)


def replaced(text: str, line: int, column: int, value: str, delimiter: str = ",") -> str:
    """`text` with one cell changed; line and column count from 1, as messages do."""
    lines = text.splitlines()
    cells = lines[line - 1].split(delimiter)
    cells[column - 1] = value
    lines[line - 1] = delimiter.join(cells)
    return "\n".join(lines) + "\n"


def without_line(text: str, line: int, count: int = 1) -> str:
    lines = text.splitlines(keepends=True)
    del lines[line - 1 : line - 1 + count]
    return "".join(lines)


def doubled(text: str, line: int) -> str:
    lines = text.splitlines(keepends=True)
    lines.insert(line, lines[line - 1])
    return "".join(lines)


def two_speeds() -> str:
    lines = samples.live_link_csv(1).splitlines()
    return "\n".join([*lines[:6], *lines[6::2]]) + "\n"


TRC, LINK, CAP = samples.trc(), samples.live_link_csv(), samples.face_cap()
VICON, MOTIVE, FACE = samples.vicon_csv(), samples.motive_csv(), samples.openface_csv()
MOCAP, TABLE = samples.ifacialmocap(), samples.marker_csv()

FAULTS = {
    "trc: a word for a number": (
        "trc", replaced(TRC, 9, 4, "oops", "\t"), r"line 9, column 4 \(brow_L\.Y\): 'oops'"),
    "trc: a ragged row": (
        "trc", replaced(TRC, 9, 4, "1\t2", "\t"), "line 9: 15 cells, 14 expected"),
    "trc: two rates": ("trc", TRC.replace("100.00", "60.00"), "DataRate says 60, .* with --rate"),
    "trc: rate of zero": ("trc", TRC.replace("100.00", "0"), "line 3 DataRate: frame rate 0"),
    "trc: no rate": ("trc", TRC.replace("DataRate", "Fast"), "line 3: DataRate is ''; it must"),
    "trc: unknown unit": ("trc", samples.trc(units="furlong"), "unit 'furlong'"),
    "trc: a name of two subjects": (
        "trc", TRC.replace("brow_R", "Kim:brow").replace("brow_L", "Lee:brow"),
        r"line 4: 1 label given more than once \(brow\); the file holds the subjects Lee, Kim"),
    "trc: a decimal comma between commas": (
        "trc", samples.trc(",").replace(".", "_", 2).replace("0.0", "0,0"), "cells, 14 expected"),
    "trc: no rows": ("trc", "\n".join(TRC.splitlines()[:5]), "no data rows"),
    "trc: no axes": ("trc", without_line(TRC, 5, 2), "line 5: begins .*must hold X1, Y1, Z1"),
    "trc: other columns": (
        "trc", TRC.replace("X1\tY1\tZ1", "X1\tZ1\tY1"), "line 5: .*Z1 and so on, in this order"),
    "trc: cut in the header": ("trc", TRC[:60], "ends before its header does"),
    "trc: a frame twice": (
        "trc", replaced(doubled(TRC, 9), 10, 3, "5", "\t"), "line 10: 7 follows 7; it must ascend"),
    "trc: a frame far away": (
        "trc", replaced(TRC, 18, 1, "900000", "\t"), "line 18: .*frames are missing"),
    "trc: half a frame": ("trc", replaced(TRC, 9, 1, "7.5", "\t"), "line 9: frame number 7.5"),
    "vicon: two takes": ("vicon-csv", VICON + "\n" + VICON, "a second block of trajectories"),
    "vicon: only devices": ("vicon-csv", VICON[: VICON.index("\nTraj")], r"no block .*Devices"),
    "vicon: two units": ("vicon-csv", VICON.replace("mm,mm,mm", "m,mm,mm", 1), "several units"),
    "vicon: no rate": ("vicon-csv", VICON.replace("\n120\n", "\nfast\n"), "the rate is 'fast'"),
    "vicon: a word for a number": (
        "vicon-csv", replaced(VICON, 18, 3, "x"), r"line 18, column 3 \(Kim:brow_L X\): 'x'"),
    "motive: no markers": (
        "motive-csv", MOTIVE.replace(",Marker", ",Bone Marker"), "Markers switched on"),
    "motive: no header": (
        "motive-csv", without_line(MOTIVE, 2, 7), "no line that begins with Frame"),
    "motive: two rates": (
        "motive-csv", MOTIVE.replace("240.0", "120.0"), "the first line says 120, .* 240"),
    "motive: a rate that is none": (
        "motive-csv", MOTIVE.replace("240.0", "fast"), "Export Frame Rate is 'fast00000'"),
    "live link: not a timecode": (
        "live-link-csv", replaced(LINK, 4, 1, "13:99:00:01"), r"line 4, column 1 .*'13:99:00:01'"),
    "live link: NaN": (
        "live-link-csv", replaced(LINK, 4, 4, "nan"), r"line 4, column 4 \(JawOpen\): 'nan'"),
    "live link: an empty cell": (
        "live-link-csv", replaced(LINK, 4, 4, ""), r"line 4, column 4 \(JawOpen\): an empty cell"),
    "live link: a ragged row": (
        "live-link-csv", replaced(LINK, 4, 4, "1,2"), "line 4: 9 cells, 8 expected"),
    "live link: a shape twice": (
        "live-link-csv", LINK.replace("JawOpen", "TongueOut"), "'TongueOut' .*twice, .* 4 and 5"),
    "live link: an empty name": (
        "live-link-csv", LINK.replace("JawOpen", ""), "line 1, column 4: the column has no name"),
    "live link: two rates": ("live-link-csv", two_speeds(), "line 8: two frame rates: .* 60 "),
    "live link: time goes back": ("live-link-csv", doubled(LINK, 4), "line 5: .*must ascend"),
    "live link: no rows": ("live-link-csv", LINK.splitlines()[0], "no row with a face"),
    "live link: one row": ("live-link-csv", "\n".join(LINK.splitlines()[:2]), "one sample"),
    "face cap: an unknown line": ("face-cap", CAP + "z,1\n", "line 15: begins 'z,1'"),
    "face cap: a short sample": ("face-cap", CAP[:-9], r"14 cells|a number"),
    "face cap: no sample": ("face-cap", "\n".join(CAP.splitlines()[:2]), "no sample"),
    "ifacialmocap: a frame cut off": (
        "ifacialmocap", MOCAP.replace("TongueOut", "x", 1), "line 2: .*differing: TongueOut"),
    "ifacialmocap: no head": ("ifacialmocap", MOCAP + "JawOpen-1|\n", "line 13: no '='"),
    "ifacialmocap: a name alone": ("ifacialmocap", "A-1|B|=head#0,0,0,0,0,0|", "'B'; a weight"),
    "openface: no face": ("openface-csv", FACE.replace(", 1, 0.1", ", 0, 0.1"), "no face found"),
    "openface: neither": (
        "openface-csv", FACE.replace("X_", "a_").replace("_r", "_c0"), "line 1: no 3-D landmarks"),
    "table: no times": ("marker-csv", TABLE.replace("time_s", "when"), "a column time_s"),
    "table: times stand still": (
        "marker-csv", "frame,time_s,a.x,a.y,a.z\n0,0,1,2,3\n1,0,1,2,3\n", "do not determine a"),
    "table: nothing seen": (
        "marker-csv", "frame,time_s,a.x,a.y,a.z\n0,0,,,\n1,1,,,\n", "none of 1 markers is seen"),
    "table: all far away": (
        "marker-csv", "frame,time_s,a.x,a.y,a.z\n0,0,2e5,3,4\n1,1,2e5,3,5\n",
        r"2 frames \(2 samples more than 100 m away, counted as gaps\); export .* in the unit"),
    "thousands": ("marker-csv", replaced(TABLE, 3, 3, '"1,234.5"'), r"column 3 .*: '1,234.5'"),
    "underscore": ("marker-csv", replaced(TABLE, 3, 3, "1_0"), r"column 3 \(brow_L\.x\): '1_0'"),
    "a NUL byte": ("marker-csv", TABLE.replace("0.0", "\0.0", 1), "character .*: a NUL byte"),
    "UTF-32": ("marker-csv", TABLE.encode("utf-32"), "NUL byte"),
    "Latin-1": ("marker-csv", TABLE.replace("chin", "größe").encode("latin-1"), "not UTF-8"),
    "a byte order mark alone": ("live-link-csv", b"\xef\xbb\xbf", "holds no text"),
    "0 bytes": ("marker-csv", "", r"empty \(0 bytes\)"),
}  # fmt: skip


@pytest.mark.parametrize("case", FAULTS)
def test_a_fault_is_a_sentence_with_the_place_the_value_and_the_remedy(tmp_path, case):
    name, content, expected = FAULTS[case]
    path = tmp_path / "kitchen.txt"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError, match=expected) as caught:
        READERS[name](path, CaptureOptions())
    message = str(caught.value)
    assert message.startswith(str(path))
    assert ";" in message or ": export" in message, "says what to do next"


@pytest.mark.parametrize("name", READERS)
def test_an_empty_file_is_refused_by_every_reader(tmp_path, name):
    (tmp_path / "kitchen.txt").write_bytes(b"")
    with pytest.raises(InputError, match=r"kitchen\.txt"):
        read_capture(tmp_path / "kitchen.txt", format=name)


def test_a_line_without_end_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(text_table, "LONGEST_LINE", 1000)
    (tmp_path / "kitchen.txt").write_text(TRC.splitlines()[0] + "\t" * 5000)
    with pytest.raises(InputError, match="line 1: longer than 1000 characters"):
        read_capture(tmp_path / "kitchen.txt")


@pytest.mark.parametrize(
    ("limit", "value", "expected"),
    [("LARGEST_BYTES", 100, "more than 0 GiB"), ("MOST_LINES", 10, "more than 10 lines")],
)
def test_a_file_beyond_the_limits_is_refused(tmp_path, monkeypatch, limit, value, expected):
    monkeypatch.setattr(text_table, limit, value)
    (tmp_path / "kitchen.txt").write_text(TRC)
    with pytest.raises(InputError, match=expected):
        read_capture(tmp_path / "kitchen.txt")


@pytest.mark.parametrize("name", READERS)
@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(spoil=damage())
def test_whatever_is_broken_only_our_own_error_escapes(tmp_path: Path, name, spoil):
    binary = {"c3d": samples.c3d, "weights-npy": samples.npy}
    content = binary[name](tmp_path) if name in binary else samples.TEXTS[name]().encode()
    path = tmp_path / "kitchen.txt"
    path.write_bytes(spoil(content))
    for format_name in (name, None):
        try:
            take = read_capture(path, format=format_name).take
        except InputError as error:
            message = str(error)
        else:
            message = str(path)
            assert take.frame_count > 0
            if take.markers is not None:
                assert abs(take.markers.positions).max() <= MAX_COORDINATE_MM
            if take.source is not None:
                assert np.isfinite(take.source.values).all()
        assert str(path) in message
