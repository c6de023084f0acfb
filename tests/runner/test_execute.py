"""Steps are found by the module that their spec names."""

import inspect
from pathlib import Path

import pytest
import scipy.linalg
from threadpoolctl import threadpool_info, threadpool_limits

from usdface.runner import execute as runner
from usdface.runner.execute import find_step
from usdface.runner.result import StepResult
from usdface.specs.base import Spec
from usdface.specs.edits import BakeSpec, EditsImportSpec, EditSpec
from usdface.specs.job import STEP_SPECS


@pytest.mark.parametrize("spec", [*STEP_SPECS, EditSpec, EditsImportSpec], ids=lambda s: s.__name__)
def test_the_module_of_every_spec_has_the_function_that_runs_it(spec: type[Spec]) -> None:
    parameters = list(inspect.signature(find_step(spec)).parameters)
    assert parameters == ["spec", "provenance", "progress"]


def blas_threads() -> list[int]:
    return [each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"]


def test_a_step_computes_with_one_thread_whatever_its_host_set(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sums over two threads are rounded otherwise than over one."""
    (tmp_path / "a.usda").write_text("#usda 1.0\n")
    threads = list[int]()

    def step(*_: object, **__: object) -> StepResult:
        threads.extend(blas_threads())
        return StepResult((), "")

    monkeypatch.setattr(runner, "find_step", lambda _: step)
    assert scipy.linalg  # whose library of threads is another than numpy's
    with threadpool_limits(2, user_api="blas"):
        runner.execute(BakeSpec(performance=tmp_path / "a.usda", out=tmp_path / "b.usda"))
        assert set(blas_threads()) == {2}
    assert set(threads) == {1}
