"""The verdict on performances, by the figures that their layers store."""

import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import get_args

from usdface.core.arrays import FloatArray
from usdface.core.errors import InputError
from usdface.core.sidecars import is_usd_name
from usdface.core.text import first_few, frame_ranges
from usdface.model.review.verdict import VERDICT_WORDS, SolveEvidence, SolveVerdict, judge_solve
from usdface.runner.origin import find_made_by, path_made_from, provenance_of, spec_of
from usdface.runner.outputs import confine
from usdface.runner.result import StepResult
from usdface.specs.review import VerdictLevel
from usdface.usdio.performance.read import PerformanceReader, read_solves
from usdface.usdio.references.weight_layers import read_keyed_references
from usdface.usdio.retarget.pairs import keyed_above, read_pairs
from usdface.usdio.take.read import is_take
from usdface.usdio.validation import Finding

WORST_VERDICT = "USDFACE_WORST_VERDICT"
"""Environment variable: worst verdict that is accepted, a `VerdictLevel`."""


def judge_performance(
    reader: PerformanceReader, *, judged: frozenset[Path] = frozenset()
) -> SolveVerdict | None:
    """Judge a performance by its layer's figures; None if it has none and no step solved it.

    Files may name each other as their source: those `judged` are not judged again.
    """
    evidence = evidence_of(reader, judged=judged)
    made = provenance_of(reader.path)
    solved = evidence.retarget or (made is not None and made.step == "map")
    unknown = evidence.uncertainty_mm is None and evidence.coverage is None
    return None if unknown and not solved else judge_solve(evidence)


def evidence_of(
    reader: PerformanceReader,
    figures: Iterable[FloatArray | None] | None = None,
    *,
    judged: frozenset[Path] = frozenset(),
) -> SolveEvidence:
    """Return the evidence of a performance's verdict.

    `figures`: uncertainty, coverage and residual, by default all that its layer stores.
    """
    uncertainty_mm, coverage, residual_mm = reader.figures() if figures is None else figures
    retarget = describe_retarget(reader.path)
    return SolveEvidence(
        reader.regions or ("face",),
        uncertainty_mm=uncertainty_mm,
        coverage=coverage,
        residual_mm=residual_mm,
        basis=reader.basis,
        retarget=retarget,
        unfollowed_share=sum(reader.header.unmatched_shares),
        bad_source=bad_source(reader.path, judged=judged) if retarget else "",
    )


def bad_source(performance: Path, *, judged: frozenset[Path] = frozenset()) -> str:
    """Return the name of a retarget's source performance if its verdict is bad, else ``''``.

    Sources that are missing, takes, or among those `judged`, resolved, are not judged.
    """
    judged = judged | {performance.resolve()}
    retargeted = find_made_by(performance, "retarget", _COPYING_STEPS)
    source = None if retargeted is None else path_made_from(retargeted, "source")
    try:
        if source is None or source.resolve() in judged:
            return ""
        if not is_usd_name(source) or is_take(source):
            return ""
        verdict = judge_performance(PerformanceReader(source), judged=judged)
    except InputError:  # damaged, or outside USDFACE_ROOT
        return ""
    return source.name if verdict is not None and verdict.level == "bad" else ""


_COPYING_STEPS = {"bake": "performance", "join": "parts", "warp": "performance"}
"""Steps whose results are judged as the performance that they read, and the field that names it."""


def describe_retarget(performance: Path) -> str:
    """Return a description of the retargeting of a performance; ``''`` if it is no retarget.

    Retargeting and pairs are found by provenance; the number of pairs is omitted if they cannot be
    read.
    """
    retargeted = find_made_by(performance, "retarget", _COPYING_STEPS)
    if retargeted is None:
        return ""
    header = PerformanceReader(performance).header
    spec = spec_of(provenance_of(retargeted))
    words = f"a retarget by {'positions' if spec.get('source_rig') else 'names'}"
    if spec.get("retargeting"):
        outs = [Path(each).name for each in spec["out"]]
        index = outs.index(retargeted.name) if retargeted.name in outs else 0
        words = f"a retarget of {_pair_words(retargeted.parent / spec['retargeting'][index])}"
    if header.gaps:
        words += f"; nothing was captured in {frame_ranges(header.gaps)}, which are filled"
    unmatched = header.unmatched
    if unmatched:
        moves = "moves and is" if len(unmatched) == 1 else "move and are"
        words += f"; {first_few(unmatched, most=3)} {moves} not followed"
    return words


def _pair_words(trained: Path) -> str:
    """Return the number of pairs of a retargeting, and how many are tuned."""
    named = [path_made_from(trained, name) for name in ("pairs", "references")]
    pairs, references = named
    try:
        confine("retarget", reads=[path for path in named if path is not None])
        count = 0 if pairs is None else len(read_pairs(pairs))
        tuned = 0 if references is None else int(read_keyed_references(references).tuned.sum())
        proposed = pairs is not None and not keyed_above(pairs)
    except InputError:
        return "pairs"
    made = None if pairs is None else provenance_of(pairs)
    if made is None:
        return "pairs"
    if not proposed or made.step != "pairs-propose":  # keys in a stronger layer hide proposals
        return f"{count + tuned} pairs, keyed by hand"
    return f"{count + tuned} pairs, {tuned or 'none'} of them tuned"


def verdict_findings(path: Path, worst: VerdictLevel | None = None) -> list[Finding]:
    """Return a finding for each solve of a layer whose verdict is not good.

    `worst`: verdicts that are worse are errors, others warnings. Default: that of the environment
    variable `WORST_VERDICT`, else ``'check'``.
    """
    levels = list(VERDICT_WORDS)
    level = worst or os.environ.get(WORST_VERDICT) or "check"
    if level not in get_args(VerdictLevel):
        raise InputError(
            f"{WORST_VERDICT}={level}: is no verdict; set it to "
            f"{' or '.join(get_args(VerdictLevel))}"
        )
    limit = levels.index(level)
    found = []
    try:
        judged = [(each, judge_performance(each)) for each in read_solves(path)]
    except InputError as error:
        return [Finding("warning", "usdface:Verdict", str(path), f"cannot be judged: {error}")]
    for reader, verdict in judged:
        if verdict is None or not verdict.figures or verdict.level == levels[0]:
            continue
        fails = levels.index(verdict.level) > limit
        words = "; ".join(filter(None, [verdict.sentence, verdict.advice]))
        if fails:
            words += f" ({WORST_VERDICT}={verdict.level} accepts it)"
        where = f"{path} <{reader.animation.GetPath()}>"
        found.append(Finding("error" if fails else "warning", "usdface:Verdict", where, words))
    return found


def with_verdict(result: StepResult, verdict: SolveVerdict | None) -> StepResult:
    """Return a step's result with the verdict on its performance in the summary."""
    if verdict is None:
        return result
    to_do = [f"to do: {verdict.advice}"] if verdict.advice else []
    return replace(
        result,
        summary=f"{verdict.sentence} ({result.summary})",
        notes=(*result.notes, *to_do),
        figures=result.figures | {"verdict": verdict.figures},
        level=verdict.level,
    )
