"""Every reader of movies, sound and pictures against files that were cut, changed and mixed up.

They are read in a process of their own, bounded in memory and time: a library of C++ may end it,
hang in it or ask for more memory than there is, and none of that may happen.
"""

from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from tests.damage import Spoil, damage
from tests.faults.conftest import together
from tests.faults.media_reader import MediaReader
from tests.faults.media_samples import EVERY, has_encoder, readers_of, write_sample

pytestmark = pytest.mark.faults

NUMBERS = (b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\xff\xff\xff\x7f", bytes(4), b"\x80\0\0\0")
"""As sizes, counts and times: the largest, the smallest and none, whichever end comes first."""
HEADER = 600
"""Where a small file tells its sizes [bytes]; what follows is packed pictures and sound."""

CONFIGURATION = """ocio_profile_version: 2
roles: {default: raw, scene_linear: lin}
displays: {sRGB: [!<View> {name: Film, colorspace: srgb}]}
colorspaces:
  - !<ColorSpace> {name: raw, isdata: true}
  - !<ColorSpace> {name: lin, aliases: [lin_rec709]}
  - !<ColorSpace>
    name: srgb
    from_scene_reference: !<ExponentTransform> {value: [0.45, 0.45, 0.45, 1]}
"""


@pytest.fixture(scope="module")
def reader() -> Iterator[MediaReader]:
    with MediaReader() as process:
        yield process


@pytest.fixture(scope="module", params=together(EVERY))
def sample(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, bytes]:
    if not has_encoder(request.param):
        pytest.skip(f"no encoder here makes {request.param}")
    path = write_sample(tmp_path_factory.mktemp("media"), request.param)
    return path, path.read_bytes()


def in_the_header() -> st.SearchStrategy[Spoil]:
    """Put numbers that no size may be where sizes are told."""
    changes = st.lists(
        st.tuples(st.integers(0, HEADER - 1), st.sampled_from(NUMBERS)), min_size=1, max_size=4
    )

    def putting(found: list[tuple[int, bytes]]) -> Spoil:
        def apply(content: bytes) -> bytes:
            changed = bytearray(content)
            for at, number in found:
                changed[at % len(changed) : at % len(changed) + len(number)] = number
            return bytes(changed)

        return apply

    return changes.map(putting)


def check(reader: MediaReader, kind: str, path: Path) -> None:
    answer = reader.ask(kind, path)
    assert answer == "read" or answer.startswith("refused: "), f"{kind}: {answer}"


FUZZ = settings(
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
    phases=(Phase.explicit, Phase.generate),
)


@FUZZ
@given(spoil=damage() | in_the_header())
def test_whatever_is_broken_only_our_own_error_escapes(
    reader: MediaReader, sample: tuple[Path, bytes], spoil: Spoil
) -> None:
    path, content = sample
    path.write_bytes(spoil(content))
    for kind in readers_of(path.name):
        check(reader, kind, path)


@FUZZ
@given(spoil=damage())
def test_a_broken_configuration_of_colours_is_read_or_refused(
    reader: MediaReader, tmp_path: Path, spoil: Spoil
) -> None:
    path = tmp_path / "config.ocio"
    path.write_bytes(spoil(CONFIGURATION.encode()))
    check(reader, "view", path)


def test_the_configuration_is_read_where_it_is_whole(reader: MediaReader, tmp_path: Path) -> None:
    path = tmp_path / "config.ocio"
    path.write_text(CONFIGURATION)
    assert reader.ask("view", path) == "read"
