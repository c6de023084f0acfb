"""Steps are found by the module that their spec names."""

import inspect

import pytest

from usdface.runner.execute import find_step
from usdface.specs.base import Spec
from usdface.specs.edits import EditsImportSpec, EditSpec
from usdface.specs.job import STEP_SPECS


@pytest.mark.parametrize("spec", [*STEP_SPECS, EditSpec, EditsImportSpec], ids=lambda s: s.__name__)
def test_the_module_of_every_spec_has_the_function_that_runs_it(spec: type[Spec]) -> None:
    parameters = list(inspect.signature(find_step(spec)).parameters)
    assert parameters == ["spec", "provenance", "progress"]
