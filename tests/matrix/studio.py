"""Commands as a studio runs them, in one folder, and what must be true of all that they write."""

import json
import shlex
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from fractions import Fraction
from io import StringIO
from itertools import pairwise
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image
from pxr import Usd

from usdface.cli import main

SAME = 1e-6
"""Largest difference of weights where a variant must not matter."""
TIMED = ("ingest", "clean", "map", "join", "bake", "combine", "package", "retarget", "warp")
"""Commands whose result has a sample at each frame of the take."""


@dataclass(frozen=True)
class Weights:
    """Sampled weights of a layer, as pxr reads them."""

    names: tuple[str, ...]
    values: np.ndarray
    timecode: str

    def __getitem__(self, name: str) -> np.ndarray:
        return self.values[:, self.names.index(name)]


@dataclass(frozen=True)
class Studio:
    """A folder, the frames of the take that is worked on there, and words of commands."""

    folder: Path
    rate: Fraction
    first: int
    last: int
    words: dict[str, object] = field(default_factory=dict)

    def __truediv__(self, name: str) -> Path:
        return self.folder / name

    def run(self, lines: str, **words: object) -> list[str]:
        """Run commands, which must succeed; check what they write; return what each prints."""
        lines = lines.strip().replace("\\\n", " ").format(**self.words, **words)
        return [self._run(shlex.split(line)) for line in lines.split("\n")]

    def _run(self, words: list[str]) -> str:
        output = StringIO()
        with chdir(self.folder), redirect_stdout(output), redirect_stderr(output):
            with pytest.raises(SystemExit) as end:
                main(words)
        shown = f"{shlex.join(words)}\n{output.getvalue()}"
        assert not end.value.code, shown
        assert "nternal error" not in shown, shown
        options = dict(pairwise(words))
        part = map(int, options.get("--frames", f"{self.first}-{self.last}").split("-"))
        frames = tuple(part) if words[0] in TIMED else ()
        for option, word in pairwise(words):
            if option in ("--out", "--picture", "--curves"):
                self.check_file(self / word, frames)
        return output.getvalue()

    def check_file(self, path: Path, frames: tuple[int, ...] = ()) -> None:
        """Check that a file is what its name says; of a layer, also its rate and samples."""
        if path.suffix in (".jpg", ".png"):
            assert np.asarray(Image.open(path).convert("L")).std() > 1, f"{path} is empty"
        elif path.suffix == ".json":
            json.loads(path.read_text(encoding="utf-8"))
        elif path.suffix in (".html", ".csv"):
            assert path.read_text(encoding="utf-8").strip()
        elif path.suffix.startswith(".usd"):
            stage = Usd.Stage.Open(str(path))
            assert not stage.GetCompositionErrors(), path
            if frames:
                assert stage.GetTimeCodesPerSecond() == pytest.approx(float(self.rate), rel=1e-9)
                assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == frames, path
                expected = np.arange(frames[0], frames[1] + 1)
                assert sampled(stage), f"{path} has no samples"
                for attribute in sampled(stage):
                    assert np.array_equal(attribute.GetTimeSamples(), expected), attribute

    def movie(self, name: str) -> tuple[Fraction, int]:
        """Return the rate of a movie and the number of its pictures."""
        with av.open(str(self / name)) as movie:
            stream = movie.streams.video[0]
            return Fraction(stream.average_rate), sum(1 for _ in movie.decode(stream))

    def weights(self, name: str) -> Weights:
        """Read the weights of a layer without usdface."""
        stage = Usd.Stage.Open(str(self / name))
        (weights,) = (each for each in sampled(stage) if each.GetName() == "blendShapeWeights")
        names = weights.GetPrim().GetAttribute("blendShapes").Get()
        timecode = weights.GetPrim().GetAttribute("face:timecode:start").Get()
        values = [weights.Get(frame) for frame in weights.GetTimeSamples()]
        return Weights(tuple(names), np.array(values), timecode or "")


def sampled(stage: Usd.Stage) -> list[Usd.Attribute]:
    """Return the animated weights and points of a stage; a layer of weights alone is of overs."""
    wanted = ("blendShapeWeights", "points")
    found = [prim.GetAttribute(name) for prim in stage.TraverseAll() for name in wanted]
    return [each for each in found if each and each.GetNumTimeSamples() > 1]


def assert_same(one: Weights, other: Weights, limit: float = SAME, *, but: str = "-") -> None:
    """Compare weights by position, as names may differ, but for shapes of the other named so."""
    assert one.values.shape == other.values.shape
    worst = np.abs(one.values - other.values).max(axis=0)
    worst[[name.startswith(but) for name in other.names]] = 0
    at = int(worst.argmax())
    assert worst[at] <= limit, f"{other.names[at]} differs by {worst[at]:.2g}"
