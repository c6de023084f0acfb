"""Phones read from the formats of aligners, and written so that they read back."""

import json
from pathlib import Path

import numpy as np
import pytest

from usdface.core.errors import InputError
from usdface.speech.phones import PhoneTrack, Span, spans_at, viseme_of
from usdface.speech.track_files import read_phone_track, write_phone_track

pytest.importorskip("praatio")

TRACK = PhoneTrack(
    phones=(Span(0, 0.25, "SIL"), Span(0.25, 0.4, "HH"), Span(0.4, 0.75, "AY")),
    words=(Span(0.25, 0.75, "hi"),),
    duration=0.75,
)


@pytest.mark.parametrize("suffix", [".TextGrid", ".json"])
def test_a_track_reads_back_the_same(tmp_path: Path, suffix: str) -> None:
    write_phone_track(tmp_path / f"x{suffix}", TRACK)
    assert read_phone_track(tmp_path / f"x{suffix}") == TRACK


@pytest.mark.parametrize("suffix", [".TextGrid", ".json"])
def test_marked_emotions_read_back(tmp_path: Path, suffix: str) -> None:
    spans = (Span(0.0, 0.4, "joy"), Span(0.4, 0.75, "anger"))
    marked = PhoneTrack(TRACK.phones, TRACK.words, spans, TRACK.duration)
    write_phone_track(tmp_path / f"x{suffix}", marked)
    back = read_phone_track(tmp_path / f"x{suffix}").emotions
    assert back == spans
    joy, anger = spans
    assert spans_at(back, np.array([0.0, 0.39, 0.4, 0.8])) == [joy, joy, anger, None]


def test_htk_in_its_own_unit_and_in_seconds_is_the_same(tmp_path: Path) -> None:
    (tmp_path / "htk.lab").write_text("0 2500000 sil\n2500000 4000000 hh hi\n4000000 7500000 ay\n")
    (tmp_path / "s.lab").write_text("0.0 0.25 sil\n0.25 0.4 hh hi\n0.4 0.75 ay\n")
    assert read_phone_track(tmp_path / "htk.lab") == read_phone_track(tmp_path / "s.lab")


SHORT = """File type = "ooTextFile"
Object class = "TextGrid"

0
0.75
<exists>
1
"IntervalTier"
"Anna - phones"
0
0.75
3
0
0.25
""
0.25
0.4
"h"
0.4
0.75
"aj"
"""


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_a_short_textgrid_of_the_montreal_aligner_is_read(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "x.TextGrid").write_text(SHORT, encoding=encoding)
    track = read_phone_track(tmp_path / "x.TextGrid")
    assert [viseme_of(span.label) for span in track.phones] == ["pau", "hh", "ao"]


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("x.wav", "", "is not a file of phones"),
        ("x.lab", "0 1 sil\n", "phones are silence"),
        ("x.lab", "0 1\nhello\n", "line 2: 'hello' is not a label"),
        ("x.lab", "0.0 0.5 ah\n0.3 0.6 b\n", "begins before 'ah' ends"),
        ("x.lab", "0.0 0.5 Ж\n0.5 0.6 Щ\n", "100% of its phones are in no alphabet"),
        ("x.lab", "0.0 0.5 S\n0.5 0.6 i:\n", "'i:': these phones are in SAMPA"),
        ("x.lab", "0.1 0.3 ah\n0.6 0.3 b\n", "'b' lasts from 0.6 to 0.3 s"),
        ("x.lab", "0.1 0.3 ah\n0.3 inf b\n", "'b' lasts from 0.3 to inf s"),
        ("x.lab", "nan 0.3 ah\n0.3 0.6 b\n", "'ah' lasts from nan to 0.3 s"),
        ("x.json", '{"phones": [{"start": 1}]}', "is not"),
        ("x.json", '{"tiers": {"phones": {"entries": [[0]]}}}', "not lists of .start, end, label"),
        (
            "x.json",
            '{"tiers": {"phones": {"entries": [[0, 1' + 400 * "0" + ', "a"]]}}}',
            "not lists of .start, end, label",
        ),
        ("x.TextGrid", "not a grid", "cannot be read as a TextGrid"),
        ("x.TextGrid", SHORT.replace("phones", "notes"), "no tier of phones, only 'Anna - notes'"),
    ],
)
def test_bad_files_are_refused_with_the_reason(
    tmp_path: Path, name: str, text: str, message: str
) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message):
        read_phone_track(tmp_path / name)


def test_recorded_textgrids_are_read(shared_data: Path) -> None:
    paths = sorted((shared_data / "speech_mfa" / "textgrid").glob("*.TextGrid"))
    assert paths
    for path in paths:
        track = read_phone_track(path)
        assert all(viseme_of(span.label) is not None for span in track.phones), path


def test_json_says_spans_plainly(tmp_path: Path) -> None:
    write_phone_track(tmp_path / "x.json", TRACK)
    data = json.loads((tmp_path / "x.json").read_text())
    assert data["words"] == [{"start": 0.25, "end": 0.75, "label": "hi"}]


def tiers_json(**tiers: list[list[object]]) -> str:
    """What the Montreal Forced Aligner writes with ``--output_format json``."""
    named = {name.replace("_", " - "): entries for name, entries in tiers.items()}
    kinds = {name: {"type": "interval", "entries": entries} for name, entries in named.items()}
    return json.dumps({"start": 0.0, "end": 3.0, "tiers": kinds})


HELLO = [[0.1, 0.4, "HH"], [0.4, 1.2, "OW1"]]
BYE = [[1.5, 1.7, "B"], [1.7, 2.0, "AY1"]]


def test_json_of_the_montreal_aligner_is_read(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text(tiers_json(words=[[0.1, 1.2, "hello"]], phones=HELLO))
    track = read_phone_track(path)
    assert [span.label for span in track.phones] == ["HH", "OW1"]
    assert [span.label for span in track.words] == ["hello"]


def test_two_speakers_are_refused_and_a_silent_one_is_not_chosen(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text(tiers_json(kim_phones=HELLO, lee_phones=BYE))
    with pytest.raises(InputError, match=r"phones of several speakers \('kim', 'lee'\)"):
        read_phone_track(path)
    bye = [[1.5, 2.0, "bye"]]
    path.write_text(
        tiers_json(lee_words=bye, kim_words=[], lee_phones=[[0.0, 3.0, "sil"]], kim_phones=HELLO)
    )
    track = read_phone_track(path)
    assert [span.label for span in track.phones] == ["HH", "OW1"]
    assert track.words == ()  # they are the other's


def test_the_phones_of_web_maus_are_its_last_tier(tmp_path: Path) -> None:
    tiers = {"ORT-MAU": [[0.1, 1.2, "hello"]], "KAN-MAU": [[0.1, 1.2, "h @ l @U"]], "MAU": HELLO}
    data = {name: {"type": "interval", "entries": entries} for name, entries in tiers.items()}
    (tmp_path / "x.json").write_text(json.dumps({"start": 0, "end": 3, "tiers": data}))
    track = read_phone_track(tmp_path / "x.json")
    assert [span.label for span in track.phones] == ["HH", "OW1"]
    assert [span.label for span in track.words] == ["hello"]


def test_emotions_hold_where_they_are_marked_in_whatever_order(tmp_path: Path) -> None:
    spans = [(2.0, 3.0, "joy"), (0.0, 1.0, "anger"), (1.0, 2.0, "calm")]
    emotions = [{"start": start, "end": end, "label": label} for start, end, label in spans]
    phones = [{"start": 0.1, "end": 0.2, "label": "AH"}]
    (tmp_path / "x.json").write_text(json.dumps({"phones": phones, "emotions": emotions}))
    marked = read_phone_track(tmp_path / "x.json").emotions
    labels = [span and span.label for span in spans_at(marked, np.array([0.5, 1.5, 2.5]))]
    assert labels == ["anger", "calm", "joy"]
