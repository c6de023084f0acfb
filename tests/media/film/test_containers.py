"""Movies that name other files, and movies whose words are none."""

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from tests.media.film.stated_movie import write_stated_movie
from usdface.core.errors import InputError
from usdface.media.film.containers import metadata_of, open_media

HLS = "#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:9.0,\n%s\n#EXT-X-ENDLIST\n"
DASH = (
    '<?xml version="1.0"?>\n<MPD xmlns="urn:mpeg:dash:schema:mpd:2011" type="static">'
    "<Period><AdaptationSet><Representation><BaseURL>%s</BaseURL></Representation>"
    "</AdaptationSet></Period></MPD>\n"
)


@pytest.mark.parametrize(
    "playlist",
    [HLS, "ffconcat version 1.0\nfile %s\n", "v=0\nm=video 5004 RTP/AVP 96\nc=IN %s\n", DASH],
    ids=["hls", "concat", "sdp", "dash"],
)
@pytest.mark.parametrize("target", ["secret.wav", "http://127.0.0.1:9/secret.wav"])
def test_a_playlist_opens_neither_files_nor_hosts(
    tmp_path: Path, playlist: str, target: str
) -> None:
    (tmp_path / "secret.wav").write_bytes(b"RIFF")
    for name in ("a.mov", "a.m3u8", "a.wav"):
        (tmp_path / name).write_text(playlist % target)
        with pytest.raises(InputError, match="cannot be read as a movie or sound"):
            open_media(tmp_path / name)


def test_a_name_that_reads_as_a_protocol_is_a_file_name(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("http:x.mov", "concat:a|b", "pipe:0"):
        with pytest.raises(InputError, match="no such file"):
            open_media(Path(name))


def test_words_that_are_no_text_can_be_printed(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    pictures = list(np.zeros((3, 64, 64, 3), np.uint8))
    write_stated_movie(path, pictures, rate=Fraction(24), comment="said by a studio")
    path.write_bytes(path.read_bytes().replace(b"said by", b"s\xe9id\xff\xfey"))
    with open_media(path) as container:
        said = metadata_of(container)["comment"]
    assert said == "s\ufffdid\ufffd\ufffdy a studio"
    said.encode("utf-8")
