"""Reading and writing of phones: Praat's TextGrid, JSON; reading of HTK's labels."""

import json
import re
from collections.abc import Mapping, Sequence
from math import inf, isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote, unquote

from usdface.core.errors import InputError
from usdface.core.replacing import replacing, write_text
from usdface.core.text import first_few, json_object, read_text
from usdface.speech.phones import PhoneTrack, Span, viseme_of

if TYPE_CHECKING:
    from praatio.data_classes.textgrid import Textgrid

LARGEST_TRACK_BYTES = 256 << 20
HTK_UNIT = 1e-7
"""Unit of time in HTK's labels [s]: 100 ns."""

ORIGIN_MARK = "usdface-provenance:"

_TRACK_SUFFIXES = (".textgrid", ".lab", ".json")
_TIERS = {
    "phones": ("phones", "phone", "phonemes", "segments", "mau", "phonetic"),
    "words": ("words", "word", "ort", "orthography"),
    "emotions": ("emotion", "emotions", "expression", "mood"),
}
_NO_WORDS = ("sil", "sp", "spn", "<eps>", "<sil>", "<s>", "</s>", "<unk>", "[noise]")
_NAME_PARTS = re.compile(r"\s*[-:/]\s*")
_WEB_MAUS = {"ort-mau": "words", "kan-mau": "dictionary"}
"""Names of WebMAUS's tiers; its phones are in `MAU`."""
_LEAST_SECONDS = 1e-6

_WRONG_TYPES = (
    *(ArithmeticError, AttributeError, LookupError, TypeError, ValueError),
    RecursionError,
)
"""What JSON of other types than expected raises."""


def read_phone_track(path: Path) -> PhoneTrack:
    """Read phones, and words and emotions if the file has them.

    `path`: ``.TextGrid`` (long, short, UTF-16 or JSON): tiers named phones, words and emotions, or
    ``speaker - phones``. ``.lab``: HTK, in 100 ns or in seconds. ``.json``:
    ``{"phones": [{"start": 0.1, "end": 0.2, "label": "AH"}, ...]}``.
    """
    suffix = path.suffix.lower()
    if suffix not in _TRACK_SUFFIXES:
        raise InputError(
            f"{path}: is not a file of phones; give one that ends in .TextGrid, .lab or .json"
        )
    text = read_text(path, LARGEST_TRACK_BYTES)
    if suffix == ".lab":
        track = _from_htk(path, text)
    elif suffix == ".json" and '"phones"' in text and '"tiers"' not in text:
        track = _from_json(path, text)
    elif suffix == ".json" and re.search(r'"tiers"\s*:\s*\{', text):
        track = _from_tiers_json(path, text)
    else:
        track = _from_textgrid(path)
    _check_track(path, track)
    return track


def write_phone_track(
    path: Path, track: PhoneTrack, *, origin: Mapping[str, object] | None = None
) -> None:
    """Write a track as JSON or, with any other extension, as a TextGrid.

    `origin`, provenance, is in a TextGrid the label of a separate tier, in JSON a key.
    """
    if path.suffix.lower() == ".json":
        write_text(path, _json_text(track, origin))
    else:
        with replacing(path) as temporary:
            _textgrid(track, origin).save(
                str(temporary), "long_textgrid", includeBlankSpaces=True, reportingMode="silence"
            )


SAMPA_MARKS = frozenset("@{}&:")
"""Characters of SAMPA that no supported alphabet has."""


def _check_track(path: Path, track: PhoneTrack) -> None:
    spoken = [span for span in track.phones if viseme_of(span.label) != "pau"]
    if not spoken:
        raise InputError(f"{path}: all of its {len(track.phones)} phones are silence")
    for before, after in zip(track.phones, track.phones[1:], strict=False):
        if after.start < before.end - 1e-3:
            raise InputError(
                f"{path}: phone {after.label!r} at {after.start:.3f} s begins before "
                f"{before.label!r} ends, at {before.end:.3f} s; export the phones again"
            )
    sampa = sorted({span.label for span in spoken if not SAMPA_MARKS.isdisjoint(span.label)})
    if sampa:  # its S and T, those of "she" and "thin", would be read as those of "see" and "tin"
        raise InputError(
            f"{path}: {first_few(map(repr, sampa))}: these phones are in SAMPA, whose letters "
            "are other phones in ARPAbet; export them as IPA (in WebMAUS, the output symbols `ipa`)"
        )
    unknown = unknown_symbols(track)
    share = sum(viseme_of(span.label) is None for span in spoken) / len(spoken)
    if share > 0.5:
        raise InputError(
            f"{path}: {share:.0%} of its phones are in no alphabet known here "
            f"({first_few(map(repr, unknown))}); use ARPAbet, TIMIT or the IPA of the "
            "Montreal Forced Aligner"
        )


def unknown_symbols(track: PhoneTrack) -> tuple[str, ...]:
    """Return the symbols of a track that are in no supported alphabet."""
    return tuple(sorted({s.label for s in track.phones if viseme_of(s.label) is None}))


def _from_htk(path: Path, text: str) -> PhoneTrack:
    """Read lines of start, end, label; an optional fourth column begins a word."""
    rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        fields = line.split()
        if not fields or fields[0] in ("#", "#!MLF!#", ".") or line.startswith('"'):
            continue
        try:
            rows.append((float(fields[0]), float(fields[1]), fields[2:]))
        except (IndexError, ValueError) as error:
            raise InputError(
                f"{path} line {number}: {line[:40]!r} is not a label; a line is start, end, phone"
            ) from error
    whole = all(start.is_integer() and end.is_integer() for start, end, _ in rows)
    # Seconds have a decimal point; large whole numbers are in HTK's unit.
    unit = HTK_UNIT if whole and max((end for _, end, _ in rows), default=0) > 1e4 else 1.0
    phones = [
        Span(round(s * unit, 7), round(e * unit, 7), fields[0] if fields else "")
        for s, e, fields in rows
    ]
    words: list[Span] = []
    for span, (_, _, fields) in zip(phones, rows, strict=True):
        if len(fields) > 1 and not re.fullmatch(r"-?\d+(\.\d+)?", fields[-1]):  # a score
            words.append(Span(span.start, span.end, fields[-1]))
        elif words and viseme_of(span.label) != "pau":
            words[-1] = Span(words[-1].start, span.end, words[-1].label)
    return _track(path, phones, words, [])


def _from_json(path: Path, text: str) -> PhoneTrack:
    try:
        data: Any = json.loads(text)
        found = [
            [Span(float(e["start"]), float(e["end"]), str(e["label"])) for e in data.get(key, [])]
            for key in ("phones", "words", "emotions")
        ]
    except _WRONG_TYPES as error:
        raise InputError(
            f'{path}: is not {{"phones": [{{"start": 0.1, "end": 0.2, "label": "AH"}}, ...]}}: '
            f"{error}"
        ) from error
    return _track(path, *found)


def _json_text(track: PhoneTrack, origin: Mapping[str, object] | None) -> str:
    def spans(entries: tuple[Span, ...]) -> list[dict[str, object]]:
        return [
            {"start": round(e.start, 6), "end": round(e.end, 6), "label": e.label} for e in entries
        ]

    data: dict[str, object] = {"phones": spans(track.phones), "words": spans(track.words)}
    if track.emotions:
        data["emotions"] = spans(track.emotions)
    if origin is not None:
        data["provenance"] = dict(origin)
    return json.dumps(data, indent=1, ensure_ascii=False) + "\n"


def _from_textgrid(path: Path) -> PhoneTrack:
    textgrid = _praatio()
    try:
        grid = textgrid.openTextgrid(
            str(path),
            includeEmptyIntervals=True,
            reportingMode="silence",
            duplicateNamesMode="rename",
        )
    except Exception as error:  # praatio raises various errors of its parser
        reason = " ".join(str(error).split())[:120]
        raise InputError(
            f"{path}: cannot be read as a TextGrid ({reason}); save it again from Praat"
        ) from error
    return _from_tiers(
        path,
        [
            (name, [entry for entry in grid.getTier(name).entries if len(entry) == 3])
            for name in grid.tierNames
        ],
    )


def _from_tiers_json(path: Path, text: str) -> PhoneTrack:
    """Read the JSON of the Montreal Forced Aligner or of praatio: tiers by name."""
    try:
        tiers = json.loads(text)["tiers"]
        return _from_tiers(path, [(name, tier["entries"]) for name, tier in tiers.items()])
    except _WRONG_TYPES as error:
        raise InputError(
            f"{path}: its tiers are not lists of [start, end, label]: {error}; export it again"
        ) from error


def _from_tiers(path: Path, tiers: Sequence[tuple[str, Sequence[Any]]]) -> PhoneTrack:
    """Return the track of the tiers of phones, words and emotions of one speaker."""
    found: dict[str, list[tuple[str, list[Span]]]] = {kind: [] for kind in _TIERS}
    for name, entries in tiers:
        *prefix, plain = _NAME_PARTS.split(_WEB_MAUS.get(name.lower(), name.lower()).strip())
        spans = [Span(float(s), float(e), str(label).strip()) for s, e, label in entries]
        for kind, names in _TIERS.items():
            if plain in names:
                found[kind].append((" ".join(prefix), spans))
    if not found["phones"]:
        raise InputError(
            f"{path}: has no tier of phones, only {', '.join(repr(name) for name, _ in tiers)}; "
            "name the tier `phones`"
        )
    spoken = [tier for tier in found["phones"] if any(viseme_of(s.label) != "pau" for s in tier[1])]
    speakers = list(dict.fromkeys(speaker for speaker, _ in spoken))
    if len(speakers) > 1:
        raise InputError(
            f"{path}: has phones of several speakers ({', '.join(map(repr, speakers))}); keep the "
            "tiers of the one who is captured"
        )
    speaker, phones = (spoken or found["phones"])[0]

    def of_speaker(kind: str) -> list[Span]:
        own = [spans for whose, spans in found[kind] if whose == speaker]
        other = [spans for whose, spans in found[kind] if not (whose and speaker)]
        return next(iter(own + other), [])

    return _track(path, phones, of_speaker("words"), of_speaker("emotions"))


def _textgrid(track: PhoneTrack, origin: Mapping[str, object] | None) -> "Textgrid":
    textgrid = _praatio()
    grid: Textgrid = textgrid.Textgrid()
    for name in ("words", "phones", "emotions"):
        spans: tuple[Span, ...] = getattr(track, name)
        entries = [(s.start, s.end, s.label) for s in spans if s.end - s.start > _LEAST_SECONDS]
        if entries:
            tier = textgrid.IntervalTier(name, entries, 0.0, max(track.duration, entries[-1][1]))
            grid.addTier(tier, reportingMode="silence")
    if origin is not None and grid.tierNames:
        label = ORIGIN_MARK + quote(json.dumps(origin))  # no characters that Praat quotes
        entries = [(0.0, float(grid.maxTimestamp), label)]
        grid.addTier(
            textgrid.IntervalTier("usdface", entries, 0.0, float(grid.maxTimestamp)),
            reportingMode="silence",
        )
    return grid


def read_origin(path: Path) -> dict[str, object] | None:
    """Return the provenance of a TextGrid, or None."""
    found = re.search(ORIGIN_MARK + r"([^\"\s]+)", read_text(path, LARGEST_TRACK_BYTES))
    return json_object(unquote(found.group(1))) if found else None


def _praatio() -> Any:
    try:
        from praatio import textgrid
    except ImportError as error:
        raise InputError(
            "TextGrids need praatio; install usdface[speech], or use .lab or .json"
        ) from error
    return textgrid


def _track(path: Path, phones: list[Span], words: list[Span], emotions: list[Span]) -> PhoneTrack:
    for span in (*phones, *words, *emotions):
        if not (isfinite(span.start) and span.start <= span.end < inf):
            raise InputError(
                f"{path}: {span.label!r} lasts from {span.start:g} to {span.end:g} s; a span must "
                "end after it starts: export the phones again"
            )
    phones, words, emotions = (
        sorted((span for span in spans if span.end > span.start), key=lambda span: span.start)
        for spans in (phones, words, emotions)
    )
    spoken = tuple(s for s in words if s.label and s.label.lower() not in _NO_WORDS)
    marked = tuple(span for span in emotions if span.label)
    return PhoneTrack(tuple(phones), spoken, marked, max((s.end for s in phones), default=0.0))
