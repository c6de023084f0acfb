"""Every reader of small files against damage: what is wrong is said by name, whatever it is."""

import contextlib
import json
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from tests.damage import DEEP, TOKENS, Spoil, damage
from tests.specs.test_takes import job
from usdface.core.errors import InputError
from usdface.core.text import read_text
from usdface.publish.integrate import read_manifest
from usdface.runner.origin import provenance_of
from usdface.specs.paths import read_path_rules
from usdface.specs.reading import read_job
from usdface.speech.forced_alignment import spoken_words
from usdface.speech.phones import PhoneTrack, Span
from usdface.speech.pronunciation import read_dictionary
from usdface.speech.track_files import read_phone_track, write_phone_track
from usdface.steps.inputs.alpha_keys import read_alpha
from usdface.steps.inputs.weight_tables import read_weight_table
from usdface.steps.surface.make_shapes import _from_csv

TRACK = PhoneTrack(
    phones=(Span(0, 0.25, "SIL"), Span(0.25, 0.4, "HH"), Span(0.4, 0.75, "AY")),
    words=(Span(0.25, 0.75, "hi"),),
    emotions=(Span(0.0, 0.4, "joy"),),
    duration=0.75,
)
RULES = {
    "version": "pathmapping-1.0",
    "path_mapping_rules": [
        {
            "source_path_format": "POSIX",
            "source_path": "/show",
            "destination_path": "/mnt/show",
        }
    ],
}
ROWS = [{"frame": n, "jawOpen": 0.1 * n, "mouthClose": 0.0} for n in range(5)]
FIGURES = {"provenance": {"usdface": "1", "step": "x", "spec": "{}", "inputs": {"a": "b"}}}


def track(suffix: str) -> bytes:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        write_phone_track(Path(folder) / f"x{suffix}", TRACK)
        return (Path(folder) / f"x{suffix}").read_bytes()


READERS: dict[str, tuple[str, Callable[[], bytes], Callable[[Path], object]]] = {
    "job": ("x.yaml", lambda: yaml.safe_dump(job(), sort_keys=False).encode(), read_job),
    "job as json": ("x.json", lambda: json.dumps(job()).encode(), read_job),
    "path rules": ("x.json", lambda: json.dumps(RULES, indent=1).encode(), read_path_rules),
    "TextGrid": ("x.TextGrid", lambda: track(".TextGrid"), read_phone_track),
    "HTK": ("x.lab", lambda: b"0 2500000 sil\n2500000 4000000 hh hi\n", read_phone_track),
    "phones as json": ("x.json", lambda: track(".json"), read_phone_track),
    "dictionary": ("x.dict", lambda: b";;; a\nkvothe  K V OW1 TH\nbast(2) B AE S T\n",
                   read_dictionary),
    "transcript": ("x.txt", lambda: b"Who's there? [laughs] 21 of 1,305 & 3.14",
                   lambda path: spoken_words(read_text(path, 1 << 20))),
    "weights": ("x.csv", lambda: b"frame,jawOpen,mouthClose\n1,0.5,0\n2,0.25,1\n",
                read_weight_table),
    "weights as json": ("x.json", lambda: json.dumps(ROWS).encode(), read_weight_table),
    "alpha": ("x.csv", lambda: b"frame,alpha\n101,0\n150,1\n",
              lambda path: read_alpha(path, np.arange(100, 160), rate=Fraction(60), whole=True)),
    "names of shapes": ("x.csv", lambda: b"frame,name\n101,smile\n150,jaw\n", _from_csv),
    "manifest": ("publish.json", lambda: json.dumps({"files": {"a": {"name": "b"}}}).encode(),
                 lambda path: read_manifest(path.parent)),
}  # fmt: skip

FUZZ = settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


def check_refused_or_read(path: Path, content: bytes, read: Callable[[Path], object]) -> None:
    path.unlink(missing_ok=True)  # file systems write at once what replaces a file's content
    path.write_bytes(content)
    with contextlib.suppress(InputError):
        read(path)


@pytest.mark.parametrize("name", READERS)
def test_a_sound_file_is_read(tmp_path: Path, name: str) -> None:
    if "TextGrid" in name:
        pytest.importorskip("praatio")
    file, sound, read = READERS[name]
    (tmp_path / file).write_bytes(sound())
    read(tmp_path / file)


@pytest.mark.parametrize("name", READERS)
@FUZZ
@given(spoil=damage())
def test_whatever_is_broken_only_our_own_error_escapes(
    tmp_path: Path, name: str, spoil: Spoil
) -> None:
    if "TextGrid" in name:
        pytest.importorskip("praatio")
    file, sound, read = READERS[name]
    check_refused_or_read(tmp_path / file, spoil(sound()), read)


@pytest.mark.parametrize("name", READERS)
def test_odd_values_stand_for_each_value_in_turn(tmp_path: Path, name: str) -> None:
    if "TextGrid" in name:
        pytest.importorskip("praatio")
    file, sound, read = READERS[name]
    content = sound()
    deep = [token[:1000] if name.startswith("job") else token for token in DEEP]  # YAML is slow
    words = sorted({*content.replace(b",", b" ").replace(b":", b" ").split()}, key=content.find)
    for number, word in enumerate(words[:24]):
        for token in TOKENS if number else TOKENS + deep:
            check_refused_or_read(tmp_path / file, content.replace(word, token, 1), read)


@pytest.mark.parametrize("file", ["x.json", "x.TextGrid", "x.png", "x.jpg", "x.mp4", "x.usda"])
@FUZZ
@given(content=st.binary(max_size=200))
@example(content=json.dumps(FIGURES).encode())
@example(content=b'{"provenance": {"usdface": 1, "inputs": {"a": [1]}}}')
def test_what_a_file_says_of_its_making_never_fails(
    tmp_path: Path, file: str, content: bytes
) -> None:
    (tmp_path / file).write_bytes(content)
    provenance_of(tmp_path / file)
