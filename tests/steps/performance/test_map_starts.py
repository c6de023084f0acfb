"""A chunk on a farm starts as quickly as it can: what mapping does not need is not imported."""

import subprocess
import sys

UNNEEDED = ("scipy", "av", "OpenImageIO", "sklearn", "openjd")


def test_mapping_imports_nothing_that_it_does_not_need() -> None:
    steps = (
        "usdface.cli.app, usdface.runner.job, usdface.steps.performance.map, "
        "usdface.steps.performance.join"
    )
    code = f"import sys, {steps}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    assert not [name for name in UNNEEDED if name in loaded]
