"""Matching of names: published lists against ARKit's, unchanged and with affixes of studios.

Half of the lists were not used when the rules were written. Then matching by deformation: heads of
several makers, whose names are replaced by numbers.
"""

import random
import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from benchmarks._published_names import PUBLISHED, Published
from tests.conftest import SHARED_DATA
from usdface.core.assets import Rig
from usdface.demo.rig import demo_rig
from usdface.demo.sculpt import ACTOR
from usdface.model.retarget.name_matching import match_names, transfer_matrix
from usdface.model.retarget.shape_matching import match_deformations
from usdface.model.retarget.shape_names import read_meanings
from usdface.model.retarget.shape_vocabulary import ARKIT
from usdface.usdio.rig.read import read_rig

_DRAWS = 40
"""Random affixes per list."""

_LETTERS = "abcdefghijklmnopqrstuvwxyz"
_SIDES = (
    ("L", "R"),
    ("l", "r"),
    ("Left", "Right"),
    ("left", "right"),
    ("LEFT", "RIGHT"),
    ("lf", "rt"),
)
_CENTRES = ("", "", "C", "c", "M", "mid")
_JOINS = ("_", ".", "-", "__", "")


def run() -> None:
    """Print the numbers of correct and wrong matches."""
    rng = random.Random(0)
    print("| source | held out | names with a counterpart | found | wrong | unlike sides |")
    print("|---|---|---|---|---|---|")
    for each in PUBLISHED:
        _row(each.name, each.held_out, [_score(each.names(), each.pairs())])
    dressed = {}
    for held_out in (False, True):
        kept = [each for each in PUBLISHED if each.held_out == held_out]
        plain = [_score(each.names(), each.pairs()) for each in kept]
        _row("**all, as published**", held_out, plain)
        dressed[held_out] = [_score(*_dressed(each, rng)) for each in kept for _ in range(_DRAWS)]
        _row("**all, with random prefixes and suffixes**", held_out, dressed[held_out])
    styled = [_score(*_styled(rng)) for _ in range(10 * _DRAWS)]
    _row("**ARKit, other sides, capitals and separators**", False, styled)
    _round_trip()
    _claims(
        {
            "sources kept out of the rules": dressed[True],
            "sources the rules were made from": dressed[False],
            "ARKit in other spellings": styled,
        }
    )
    _deformations()


def _claims(totals: dict[str, list[tuple[int, int, int, int]]]) -> None:
    """Print the claims."""
    print("\n| names with a counterpart, dressed at random | wanted | measured |")
    print("|---|---|---|")
    for label, each in totals.items():
        found, count, _, _ = map(sum, zip(*each, strict=True))
        print(f"| {label}: found | ≥ 98 % | {found / count:.2%} |")
    every = [score for each in totals.values() for score in each]
    print(f"| pairs that nobody published | 0 | {sum(score[2] for score in every)} |")
    print(f"| one side matched without the other | 0 | {sum(score[3] for score in every)} |")


def _deformations() -> None:
    """Print how many shapes of heads with foreign names are matched with their counterparts."""
    files = sorted((SHARED_DATA / "rigs").glob("*.usdc"))
    heads = {"demo": demo_rig(), "demo's actor": demo_rig(ACTOR)}
    heads |= {file.stem: read_rig(file) for file in files}
    print("\n| heads with foreign names | shapes with a counterpart | matched | right | one side |")
    print("|---|---|---|---|---|")
    totals = np.zeros(4, np.int64)
    for (one, source), (other, target) in combinations(heads.items(), 2):
        meanings = [
            {name: meant.cells for name, meant in read_meanings(rig.shapes).items()}
            for rig in (source, target)
        ]
        count = sum(cells in meanings[1].values() for cells in meanings[0].values())
        (numbered, names), (numbered_too, names_too) = map(_numbered, (source, target))
        matches = match_deformations(
            numbered,
            numbered_too,
            source_shapes=numbered.shapes,
            target_shapes=numbered_too.shapes,
        )
        meant = [
            (meanings[0][names[each.source]], meanings[1][names_too[each.target]])
            for each in matches
        ]
        right = sum(ours == theirs for ours, theirs in meant)
        half = sum(bool(ours & theirs) for ours, theirs in meant) - right
        row = np.array([count, len(matches), right, half])
        totals += row
        print(f"| {one}, {other} | {' | '.join(map(str, row))} |", flush=True)
    print(f"| **all** | {' | '.join(map(str, totals))} |")


def _numbered(rig: Rig) -> tuple[Rig, dict[str, str]]:
    """Return a rig with numbers as names, and its own names by number."""
    order = np.random.default_rng(0).permutation(len(rig.shapes)).tolist()
    numbers = {name: f"form_{number}" for name, number in zip(rig.shapes, order, strict=True)}
    meshes = tuple(
        replace(mesh, shapes=tuple(replace(each, name=numbers[each.name]) for each in mesh.shapes))
        for mesh in rig.meshes
    )
    numbered = replace(rig, shapes=tuple(numbers[name] for name in rig.shapes), meshes=meshes)
    return numbered, {number: name for name, number in numbers.items()}


def _row(label: str, held_out: bool, scores: Sequence[tuple[int, int, int, int]]) -> None:
    found, count, wrong, unlike = map(sum, zip(*scores, strict=True))
    print(
        f"| {label} | {'yes' if held_out else 'no'} | {count:,} | {found / count:.2%} | {wrong} | "
        f"{unlike} |"
    )


def _score(names: Sequence[str], pairs: frozenset[tuple[str, str]]) -> tuple[int, int, int, int]:
    """Return the numbers of fully matched names, of names, of wrong pairs and of one-sided pairs.

    A pair that is not published is wrong; a pair is one-sided if its mirror image is not matched.
    """
    matches = match_names(ARKIT, names).matches
    matched = {(match.name, name) for match in matches for name, _ in match.target}
    wanted = {theirs for _, theirs in pairs}
    found = sum(
        {pair for pair in matched if pair[1] == name} == {pair for pair in pairs if pair[1] == name}
        for name in wanted
    )
    ours = {match.name for match in matches}
    expected = {arkit for arkit, _ in pairs}
    unlike = sum(
        (name in ours) != (other in ours)
        for name in expected
        if name.endswith("Left") and (other := f"{name[:-4]}Right") in expected
    )
    return found, len(wanted), len(matched - pairs), unlike


def _dressed(given: Published, rng: random.Random) -> tuple[list[str], frozenset[tuple[str, str]]]:
    """Return a list with a prefix and a suffix on all names."""
    before = "".join(_word(rng) + rng.choice("_.:-") for _ in range(rng.randint(1, 3)))
    after = rng.choice(("", "_" + _word(rng), "." + _word(rng)))
    dressed = {name: before + name + after for name in given.names()}
    pairs = frozenset((ours, dressed[theirs]) for ours, theirs in given.pairs())
    return list(dressed.values()), pairs


def _word(rng: random.Random) -> str:
    word = "".join(rng.choices(_LETTERS, k=rng.randint(2, 8)))
    digits = str(rng.randint(0, 99)) if rng.random() < 0.3 else ""
    return rng.choice((word, word.upper(), word.title())) + digits


def _styled(rng: random.Random) -> tuple[list[str], frozenset[tuple[str, str]]]:
    """Return ARKit's names in another style."""
    left, right = rng.choice(_SIDES)
    centre, join, first = rng.choice(_CENTRES), rng.choice(_JOINS), rng.random() < 0.4
    case = rng.choice((str.title, str.lower, str.upper, str))
    prefix = rng.choice(("", "", _word(rng) + "_"))
    found = []
    for name in ARKIT:
        words = re.findall(r"[A-Z]?[a-z]+", name)
        one_sided = words[-1] in ("Left", "Right") and name not in _DIRECTIONS
        side = {"Left": left, "Right": right}[words.pop()] if one_sided else centre
        body = [case(word) for word in words]
        if not join:
            body = [word.title() for word in words]
            side = side.title()
        parts = ([side, *body] if first else [*body, side]) if side else body
        found.append((name, prefix + join.join(parts)))
    return [theirs for _, theirs in found], frozenset(found)


_DIRECTIONS = ("jawLeft", "jawRight", "mouthLeft", "mouthRight")
"""Names whose side is a direction."""


def _round_trip() -> None:
    """Print the round-trip error of every shape over the names of each list."""
    print("\n| ARKit to these names and back | largest difference |")
    print("|---|---|")
    for given in PUBLISHED:
        names = given.names()
        there = match_names(ARKIT, names).matches
        back = match_names(names, ARKIT).matches
        whole = transfer_matrix(there, ARKIT, names) @ transfer_matrix(back, names, ARKIT)
        known = [ARKIT.index(match.name) for match in there]
        error = max(abs(float(whole[i, j]) - (i == j)) for i in known for j in range(len(ARKIT)))
        print(f"| {given.name} | {error:.1e} |")
