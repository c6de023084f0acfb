"""Look for what is not in order in layers."""

from dataclasses import asdict
from pathlib import Path

from usdface.core.text import pluralize
from usdface.runner.outputs import confine
from usdface.runner.result import StepResult
from usdface.usdio.validation import validate


def validate_layers(layers: tuple[Path, ...]) -> StepResult:
    """Run USD's validators and ours on layers; errors are failures, warnings are not."""
    confine("validate", reads=layers)
    found = {str(layer): validate(layer) for layer in layers}
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
