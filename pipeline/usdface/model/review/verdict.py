"""The verdict on a solve: whether it can be used, the evidence, and what to do.

Every frame is graded in each region by coverage, uncertainty and residual (distance of the markers
from the solve, less that at the references); with keys, by the error against them instead::

    bad     coverage below 1/2, or a figure in millimetres above VISIBLE_ERROR_MM
    check   coverage below 3/4, or a figure in millimetres above half of VISIBLE_ERROR_MM
    good    otherwise

Limits of errors on a rig that is not about life-size are in proportion to its face.

A take is bad if more than `_BAD_SHARE` of its frames are bad in some region, or if more than
`_CHANCE_SHARE` exceed `WRONG_EXPRESSION_MM`. It is good if at most `_CHANCE_SHARE` need a check, at
least half of the references are tuned, and the rig has not changed and has shapes for all regions
with markers. Coverage is used in addition to uncertainty, which is calibrated on the references and
does not contain errors that none shows.

A retargeting has no such figures. It is bad if more than `_BAD_SHARE` of the source's motion drives
nothing, or if its source is bad.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray
from usdface.core.assets import SolveBasis
from usdface.core.text import first_few
from usdface.model.mapping.coverage import LEAST_COVERAGE

VISIBLE_ERROR_MM = 1.0
"""Clearly visible error of a region: five pixels if a face of 220 mm fills 1080 lines. A pixel is
one minute of arc at HDTV's design viewing distance (ITU-R BT.1845)."""

WRONG_EXPRESSION_MM = 3.0
"""Error of a region that changes the expression: more than a third of a smile, which moves the
corners of the mouth by 8 mm."""

_LIFE_SIZE = (0.5, 2.0)
"""Motion of a rig over the performer's within which its limits are those of an adult's face."""

_BAD_COVERAGE = 0.5
"""Coverage of a region below which a frame is bad."""

_CHANCE_SHARE = 0.05
"""Share of the frames that exceed two standard deviations by chance."""

_BAD_SHARE = 0.5
"""Share of bad frames above which mapping again is less work than edits."""

_PAIR_ADVICE = (
    "give these shapes counterparts, in a table (`usdface names`, --names) or in pairs to train on "
    "(`usdface train-retarget`), then retarget again"
)

VERDICT_WORDS = {"good": "Good", "check": "Check", "bad": "Do not use"}
"""First words of the verdict by level, the best level first."""


@dataclass(frozen=True)
class SolveVerdict:
    """Whether a solve can be used."""

    level: str
    """``'good'``, ``'check'`` or ``'bad'``."""
    sentence: str
    """Opening and evidence."""
    advice: str = ""
    """What to do; empty if there is nothing to do."""
    figures: dict[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class SolveEvidence:
    """Figures of a solve, each (frames, regions) with the whole face first; None if unknown."""

    regions: tuple[str, ...]
    uncertainty_mm: FloatArray | None = None
    coverage: FloatArray | None = None
    """[0-1]"""
    residual_mm: FloatArray | None = None
    error_mm: FloatArray | None = None
    """Against keys; NaN for frames without [mm]."""
    basis: SolveBasis | None = None
    by_markers: bool = True
    """False for captured weights, such as a phone's."""
    retarget: str = ""
    """Description of the retargeting; empty for other performances."""
    unfollowed_share: float = 0.0
    """Share of the motion of a retargeting's source that drives nothing [0-1]."""
    bad_source: str = ""
    """Name of a retargeting's source with a bad verdict; else empty."""
    has_video: bool = False

    def on_rig(self, limit_mm: float) -> float:
        """Return a limit of errors of an adult's face in millimetres of the rig."""
        scale = 1.0 if self.basis is None else self.basis.motion_scale
        return limit_mm if _LIFE_SIZE[0] <= scale <= _LIFE_SIZE[1] else scale * limit_mm

    def exceeds(self, limit_mm: float, least_coverage: float) -> dict[str, BoolArray]:
        """Return where each figure exceeds its limit, (frames, regions), by the limit's name.

        Parameters
        ----------
        limit_mm : float
            On an adult's face. Residuals are the performer's.
        least_coverage : float
            [0-1]
        """
        on_rig = self.on_rig(limit_mm)
        if self.error_mm is not None:
            keyed = self.error_mm[~np.isnan(self.error_mm).all(axis=1)]  # others are not judged
            return {f"error over {on_rig:.2g} mm": np.nan_to_num(keyed) > on_rig}
        found = {}
        if self.uncertainty_mm is not None:
            found[f"expected error over {on_rig:.2g} mm"] = self.uncertainty_mm > on_rig
        if self.residual_mm is not None:
            found[f"residual over {limit_mm:g} mm"] = self.residual_mm > limit_mm
        if self.coverage is not None:
            found[f"coverage below {least_coverage:.0%}"] = self.coverage < least_coverage
        width = min((each.shape[1] for each in found.values()), default=0)
        return {
            name: each[:, :width] for name, each in found.items()
        }  # earlier versions have the face only


def judge_solve(evidence: SolveEvidence) -> SolveVerdict:
    """Return the verdict that sheets, reports, movies and messages show."""
    doubtful = evidence.exceeds(VISIBLE_ERROR_MM / 2, LEAST_COVERAGE)
    bad = evidence.exceeds(VISIBLE_ERROR_MM, _BAD_COVERAGE)
    if not bad:
        return _judge_without_figures(evidence)
    basis = evidence.basis
    proposals = basis is not None and 2 * basis.tuned < basis.pairs
    changed, without_markers, without_shapes = _limits_of_basis(evidence)
    level, beyond = "bad", bad
    if _frame_share(bad) <= _BAD_SHARE:
        wrong = evidence.exceeds(WRONG_EXPRESSION_MM, 0.0)
        if _frame_share(wrong) > _CHANCE_SHARE:
            beyond = wrong
        else:
            stated = changed or without_shapes
            unproven = proposals and evidence.error_mm is None
            checked = _frame_share(doubtful) > _CHANCE_SHARE or unproven or stated
            level, beyond = "check" if checked else "good", doubtful
    shares = _by_any(beyond).mean(axis=0)
    # Regions that exceed limits in more frames than chance, the worst first.
    found = {
        region: float(share)
        for region, share in zip(evidence.regions[1:], shares[1:], strict=False)
        if share > _CHANCE_SHARE
    }
    where = dict(sorted(found.items(), key=lambda item: -item[1]))
    retarget = evidence.retarget if evidence.unfollowed_share > _CHANCE_SHARE else ""
    parts = [retarget, _coverage(evidence), _tuned(evidence), changed, without_markers]
    parts += [without_shapes, _error(evidence), _residual(evidence)]
    if level != "good" and where:
        columns = [evidence.regions.index(region) for region in where]
        parts.append(f"{_list_limits(beyond, columns)}: {_list_regions(where)}")
    return SolveVerdict(
        level,
        f"{VERDICT_WORDS[level]}: {'; '.join(filter(None, parts))}",
        _PAIR_ADVICE if retarget else _advice(evidence, level, where, proposals),
        {
            "level": level,
            "bad_share": round(_frame_share(bad), 4),
            "check_share": round(_frame_share(doubtful), 4),
            "regions": {
                region: round(float(share), 4)
                for region, share in zip(evidence.regions, shares, strict=False)
            },
        },
    )


def _judge_without_figures(evidence: SolveEvidence) -> SolveVerdict:
    """Return the verdict on weights without figures, from their origin."""
    if evidence.unfollowed_share > _BAD_SHARE:
        share = round(evidence.unfollowed_share, 4)
        return SolveVerdict(
            "bad",
            f"{VERDICT_WORDS['bad']}: {evidence.retarget}: {share:.0%} of the source's motion",
            _PAIR_ADVICE,
            {"level": "bad", "unfollowed_share": share},
        )
    if evidence.bad_source:
        source = evidence.bad_source
        return SolveVerdict(
            "bad",
            f"{VERDICT_WORDS['bad']}: {evidence.retarget}; its source, {source}, has that verdict "
            "too",
            f"correct {source} (`usdface validate` gives the reason), then retarget again",
            {"level": "bad", "source": source},
        )
    if evidence.retarget or not evidence.by_markers:
        what = evidence.retarget or "weights of another solver"
        return SolveVerdict(
            "check",
            f"{VERDICT_WORDS['check']}: {what}; the error is not known without keys",
            ("compare with the video, or " if evidence.has_video else "")
            + "measure against keys (--against)",
        )
    return SolveVerdict(
        "check",
        f"{VERDICT_WORDS['check']}: this solve has no record of its references or its error",
        "map it with a mapping, or measure it against keys (--against)",
        {"level": "check"},
    )


def worst_verdict(verdicts: Mapping[str, SolveVerdict]) -> SolveVerdict:
    """Return the worst of several verdicts, with the name of its solve if there are several."""
    levels = list(VERDICT_WORDS)
    name, worst = max(verdicts.items(), key=lambda each: levels.index(each[1].level))
    if len(verdicts) == 1:
        return worst
    opening = VERDICT_WORDS[worst.level]
    sentence = worst.sentence.replace(opening, f"{opening} ({name})", 1)
    return replace(worst, sentence=sentence, figures=worst.figures | {"of": name})


def _is_covered(evidence: SolveEvidence) -> bool:
    """Whether the references cover most frames, so that only their weights may be wrong."""
    beyond = replace(evidence, uncertainty_mm=None).exceeds(VISIBLE_ERROR_MM, _BAD_COVERAGE)
    return bool(beyond) and _frame_share(beyond) <= _BAD_SHARE


def _by_any(beyond: Mapping[str, BoolArray]) -> BoolArray:
    """Return where any figure exceeds its limit: (frames, regions)."""
    return np.asarray(np.any([*beyond.values()], axis=0))


def _frame_share(beyond: Mapping[str, BoolArray]) -> float:
    """Return the share of the frames in which any figure of any region exceeds its limit."""
    return float(_by_any(beyond).any(axis=1).mean())


def _list_limits(beyond: Mapping[str, BoolArray], columns: list[int]) -> str:
    """Name the limits that some regions exceed in more frames than chance."""
    shares = {name: each[:, columns].mean(axis=0).max() for name, each in beyond.items()}
    most = max(shares.values())
    listed = [name for name, share in shares.items() if share >= min(_CHANCE_SHARE, most)]
    return " or ".join(listed)


def _list_regions(where: dict[str, float]) -> str:
    words = [f"the {region} in {share:.0%}" for region, share in where.items()]
    return first_few([f"{words[0]} of the frames", *words[1:]], most=2)


def _limits_of_basis(evidence: SolveEvidence) -> tuple[str, str, str]:
    """Name changed shapes of the rig, regions without markers, and regions without shapes.

    Each empty if there are none, or if keys tell the error.
    """
    basis = evidence.basis
    if basis is None or evidence.error_mm is not None:
        return "", "", ""
    shapes = first_few(basis.changed_shapes, most=2) if basis.changed_shapes else ""
    unseen = " and the ".join(basis.regions_without_markers)
    still = " and the ".join(basis.regions_without_shapes)
    return (
        f"shapes of the rig have changed since training: {shapes}" if shapes else "",
        f"no marker sees the {unseen}: weights there are guessed from the rest of the face"
        if unseen
        else "",
        f"the rig has no shapes for the {still}: their markers are not followed" if still else "",
    )


def _error(evidence: SolveEvidence) -> str:
    if evidence.error_mm is not None:
        face = evidence.error_mm[:, 0]
        high = np.nanpercentile(face, 95)
        return f"{np.nanmean(face):.2f} mm off the keys, 95th percentile {high:.2f} mm"
    if evidence.uncertainty_mm is None:
        return ""
    mean = evidence.uncertainty_mm.mean(axis=0)
    words = f"expected error {mean[0]:.2f} mm"
    if len(mean) > 1:
        most = 1 + int(mean[1:].argmax())
        if mean[most] > mean[0]:
            words += f", {evidence.regions[most]} {mean[most]:.2f} mm"
    return words


def _coverage(evidence: SolveEvidence) -> str:
    if evidence.coverage is None:
        return ""
    covered = (evidence.coverage >= LEAST_COVERAGE).mean(axis=0)
    words = f"references cover {covered[0]:.0%} of the frames"
    if len(covered) > 1:
        least = 1 + int(covered[1:].argmin())
        if covered[least] < covered[0]:
            words += f", {evidence.regions[least]} {covered[least]:.0%}"
    return words


def _tuned(evidence: SolveEvidence) -> str:
    basis = evidence.basis
    if basis is None:
        return ""
    if basis.tuned == 0:
        return f"none of the {basis.pairs} references is tuned"
    return f"{basis.tuned} of {basis.pairs} references are tuned"


def _residual(evidence: SolveEvidence) -> str:
    """State the residual of the face if it is visible."""
    if evidence.residual_mm is None or evidence.error_mm is not None:
        return ""
    face = float(np.sqrt((evidence.residual_mm[:, 0] ** 2).mean()))
    return f"residual {face:.1f} mm" if face > VISIBLE_ERROR_MM / 2 else ""


def _advice(evidence: SolveEvidence, level: str, where: dict[str, float], proposals: bool) -> str:
    basis = evidence.basis
    without_markers = () if basis is None else basis.regions_without_markers
    still = () if basis is None else basis.still_regions
    shown = [region for region in where if region not in without_markers]
    if without_markers and where and not shown and evidence.error_mm is None:
        regions = " and the ".join(without_markers)
        return f"use the rest of the face alone, or capture the {regions} with markers"
    steps = []
    if level == "bad" and evidence.error_mm is None and not (proposals and _is_covered(evidence)):
        parts = " and the ".join(shown[:2] or still[:2])
        steps.append(
            "add frames of this take to the references"
            + (f", chosen for the {parts}" if parts else "")
            + ("," if parts and proposals else "")
        )
    if proposals and basis is not None and (level == "bad" or evidence.error_mm is None):
        steps.append(f"tune the references ({basis.pairs - basis.tuned} are proposals)")
    if not steps and level != "bad" and _limits_of_basis(evidence)[0]:
        return "tune the pairs that show them again, then train and map again"
    if steps:
        return f"{' and '.join(steps)}, then train and map again"
    return "" if level == "good" else "look at the moments to review first"
