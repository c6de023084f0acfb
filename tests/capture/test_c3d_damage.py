"""Damaged C3D files: whatever the bytes, a take comes out or one clear error; never a hang."""

import functools
import tempfile
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.c3d_write import write_c3d
from usdface.capture.c3d import open_c3d
from usdface.capture.sniff import read_capture
from usdface.core.errors import InputError

DAMAGE = settings(
    deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@functools.cache
def sound_file() -> bytes:
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "take.c3d"
        write_c3d(
            path,
            rng.normal(0, 100, (12, 4, 3)),
            rng.random((12, 4)) > 0.2,
            ["brow", "lip", "chin", "nose"],
            rate=60,
            analog=rng.normal(size=(24, 2)),
            analog_labels=["mic", "sync"],
        )
        return path.read_bytes()


def read_all(path: Path) -> None:
    """Read what there is; the take must keep its promises."""
    refusal = ""
    markers = None
    try:
        file = open_c3d(path)
        file.read_analog()
        file.events()
        markers = read_capture(path, format="c3d").take.markers
    except InputError as error:
        refusal = str(error)
    if refusal:
        assert path.name in refusal
        return
    assert markers is not None
    assert np.isfinite(markers.positions).all()
    assert (markers.positions != 0).any(axis=2).all()
    assert len(set(markers.names)) == len(markers.names) == markers.positions.shape[1]


@DAMAGE
@given(length=st.integers(0, 4000))
def test_a_file_cut_anywhere_is_read_or_refused(tmp_path, length):
    path = tmp_path / "cut.c3d"
    path.write_bytes(sound_file()[:length])
    read_all(path)


@DAMAGE
@given(changes=st.lists(st.tuples(st.integers(0, 1600), st.integers(0, 255)), max_size=8))
def test_a_file_with_any_bytes_changed_is_read_or_refused(tmp_path, changes):
    content = bytearray(sound_file())
    for at, value in changes:
        content[at] = value
    path = tmp_path / "flipped.c3d"
    path.write_bytes(content)
    read_all(path)


@DAMAGE
@given(content=st.binary(max_size=2048), processor=st.sampled_from([84, 85, 86]))
def test_noise_behind_a_sound_beginning_is_read_or_refused(tmp_path, content, processor):
    raw = bytearray(content.ljust(1024, b"\x00"))
    raw[0:2], raw[512:516] = b"\x02\x50", bytes((1, 0x50, 1, processor))
    path = tmp_path / "noise.c3d"
    path.write_bytes(raw)
    read_all(path)


def test_every_single_byte_of_header_and_parameters_may_be_wrong(tmp_path):
    sound = sound_file()
    path = tmp_path / "byte.c3d"
    for at in range(0, 1536, 3):
        content = bytearray(sound)
        content[at] ^= 0xFF
        path.write_bytes(content)
        read_all(path)
