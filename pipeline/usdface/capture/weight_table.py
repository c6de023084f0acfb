"""From a table of weights to a take: choice of the take, unit, and times of the rows."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import cast

import numpy as np

from usdface.capture.channel_take import LARGEST_FRACTION, build_channel_take
from usdface.capture.marker_take import Capture, CaptureOptions
from usdface.capture.sample_times import (
    SampleTimes,
    check_rate,
    rate_of_times,
    resolve_device_times,
    resolve_frame_numbers,
    whole_numbers,
)
from usdface.capture.weight_samples import WeightSamples, read_weight_samples
from usdface.core.arrays import FloatArray, IntArray
from usdface.core.errors import InputError
from usdface.core.rates import exact_rate
from usdface.core.text import first_few, pluralize

_OTHER_RATE = 1.2
"""Ratio between a stated rate and that of the times above which the times are used."""


def read_weight_take(path: Path, options: CaptureOptions) -> Capture:
    """Read a table of weights as a take."""
    samples = _one_take(path, read_weight_samples(path, shapes=options.shapes), options.take)
    notes = [f"not read: {first_few(samples.ignored)}"] if samples.ignored else []
    values = in_fractions(path, samples.values, options.weight_unit, samples.names, notes)
    first, times = _times(path, samples, options.rate, notes)
    built = build_channel_take(
        path, samples.names, values, times, notes=notes, format_name="weights", first_frame=first
    )
    return replace(built, take=replace(built.take, name=options.take or built.take.name))


def row_frames(path: Path, samples: WeightSamples) -> tuple[IntArray, Fraction | None]:
    """Return the frame of each row, numbered as by `ingest`, and the rate if the file gives it.

    Without frame numbers, takes begin at frame 1 and rows are consecutive or at their times.
    """
    if samples.frames is not None:
        frames = whole_numbers(samples.frames, samples.lines, where=str(path))
        return frames, samples.rate or _rate_beside(path, samples, frames)
    takes = np.array(samples.takes or [""] * len(samples.values), object)
    frames, rate = np.zeros(len(takes), np.int64), samples.rate
    for take in dict.fromkeys(takes.tolist()):
        rows = np.flatnonzero(takes == take)
        if samples.seconds is None:
            frames[rows] = 1 + np.arange(len(rows))
            continue
        first, times = _times(path, samples.rows(rows), None, [])
        if not times.even:
            raise InputError(
                f"{path}: its rows are at uneven times, which do not determine frames; "
                "number them in a `frame` column"
            )
        frames[rows], rate = first + np.rint(times.frames).astype(np.int64), times.rate
    return frames, rate


def _rate_beside(path: Path, samples: WeightSamples, frames: IntArray) -> Fraction | None:
    """Return the rate of numbered rows with times; None unless both ascend."""
    times = samples.seconds
    if times is None or len(frames) < 2 or not (np.diff(frames) > 0).all():
        return None
    return rate_of_times(times, frames, where=str(path)) if (np.diff(times) > 0).all() else None


def in_fractions(
    path: Path, values: FloatArray, unit: str | None, names: Sequence[str], notes: list[str]
) -> FloatArray:
    """Return weights as fractions of 1; values in percent require a stated unit."""
    if unit == "percent":
        notes.append("weights read as percent, as stated")
        return values * 0.01
    if unit is None and values.size and np.abs(values).max() > LARGEST_FRACTION:
        row, column = np.unravel_index(int(np.abs(values).argmax()), values.shape)
        raise InputError(
            f"{path}: {names[int(column)]} is {values[row, column]:g}, and weights are about 0 to "
            "1: state --weight-unit percent if 100 is the full shape, or --weight-unit one if the "
            "weights are meant as they are"
        )
    return values


def _one_take(path: Path, samples: WeightSamples, take: str | None) -> WeightSamples:
    counts = Counter(samples.takes)
    if len(counts) < 2 and (take is None or not counts):
        return samples
    if take not in counts:
        raise InputError(
            f"{path}: holds rows of {pluralize(len(counts), 'take')} ({first_few(counts)}); name "
            "the one to read with --take (of `usdface ingest`)"
        )
    chosen = np.flatnonzero(np.array(samples.takes, object) == take)
    return replace(samples.rows(chosen), takes=())


def _times(
    path: Path, samples: WeightSamples, rate: float | None, notes: list[str]
) -> tuple[int, SampleTimes]:
    """Return the first frame number, and the frames of the rows."""
    where, seconds = str(path), samples.seconds
    stated = samples.rate if rate is None else exact_rate(rate, where="--rate")
    if samples.frames is not None:
        first, frames = resolve_frame_numbers(samples.frames, samples.lines, where=where)
    elif seconds is None:
        first, frames = 1, np.arange(len(samples.values), dtype=np.int64)
    else:
        if stated is not None and rate is None and _differs(stated, seconds, notes):
            stated = None
        if stated is None:
            return 1, resolve_device_times(seconds, samples.lines, where=f"{path} times")
        numbers = np.rint((seconds - seconds[0]) * float(stated)) + 1.0
        first, frames = resolve_frame_numbers(numbers, samples.lines, where=where)
    if seconds is None and stated is None:
        raise InputError(
            f"{path}: has no column of times and states no rate; give the frames per second "
            "with --rate, or give a take, ingested with it, if this command has no such option"
        )
    if stated is None:
        stated = rate_of_times(cast(FloatArray, seconds), frames, where=where)
    elif seconds is not None:
        check_rate(stated, "the file" if rate is None else "--rate", seconds, frames, where=where)
    elif rate is not None:
        other = samples.rate not in (None, stated)
        instead = f"; the file says {float(samples.rate or 0):g}" if other else ""
        notes.append(f"{float(stated):g} frames per second, as stated{instead}")
    return first, SampleTimes(stated, frames.astype(np.float64), even=True)


def _differs(stated: Fraction, seconds: FloatArray, notes: list[str]) -> bool:
    """Return whether the times of rows contradict the rate that the file states, and note it."""
    step = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 0.0
    if not step > 0 or 1 / _OTHER_RATE < step * float(stated) < _OTHER_RATE:
        return False
    notes.append(
        f"the file states {float(stated):g} frames per second, and its times {1 / step:.4g}: the "
        "times are followed"
    )
    return True
