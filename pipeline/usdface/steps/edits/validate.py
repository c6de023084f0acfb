"""Validate USD layers and the verdict on their solves."""

from dataclasses import asdict
from pathlib import Path

from usdface.core.text import pluralize
from usdface.runner.outputs import confine
from usdface.runner.result import StepResult
from usdface.specs.review import VerdictLevel
from usdface.steps.inputs.solve_verdict import verdict_findings
from usdface.usdio.validation import Finding, validate


def check_layer(layer: Path, *, worst: VerdictLevel | None = None) -> list[Finding]:
    """Return the findings of all validators and of `verdict_findings` on a layer."""
    return sorted([*validate(layer), *verdict_findings(layer, worst)], key=lambda f: f.severity)


def validate_layers(
    layers: tuple[Path, ...], *, worst_verdict: VerdictLevel | None = None
) -> StepResult:
    """Run `check_layer` on layers; errors are failures, warnings are not."""
    confine("validate", reads=layers)
    found = {str(layer): check_layer(layer, worst=worst_verdict) for layer in layers}
    findings = [finding for each in found.values() for finding in each]
    errors = [finding for finding in findings if finding.severity == "error"]
    warnings = len(findings) - len(errors)
    counted, wrong = pluralize(len(layers), "layer"), pluralize(len(errors), "error")
    return StepResult(
        (),
        f"{counted}: {wrong}, {pluralize(warnings, 'warning')}",
        table=tuple(f"{f.severity}: {f.where}: {f.message} [{f.check}]" for f in findings),
        figures={name: [asdict(finding) for finding in each] for name, each in found.items()},
        failures=(f"{wrong} in {counted}",) if errors else (),
    )
