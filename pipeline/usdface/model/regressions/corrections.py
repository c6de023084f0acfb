"""The local corrections of all voices together, condensed where that comes to the same."""

from typing import Any

from usdface.core.arrays import FloatArray
from usdface.model.regressions.base import Predictor
from usdface.model.regressions.voices import Voice, local_sums
from usdface.numerics.array_namespace import CPU, ArrayDevice
from usdface.numerics.regression.condensed_function import CondensedFunction, condense
from usdface.numerics.regression.local_sums import LocalSums

CONDENSED = "condensed_"

FEW_KERNELS = 3000
"""Up to which all of them are as quick as what they would be condensed to."""


def stack_corrections(voices: list[tuple[Voice, FloatArray]]) -> dict[str, FloatArray]:
    """Gather what the voices correct, as `prepare_corrections` reads it.

    Parameters
    ----------
    voices : list of (Voice, (s,) float array)
        With how far each is heard for each shape.
    """
    arrays: dict[str, FloatArray] = {}
    for k, (voice, part) in enumerate(voices):
        if voice.locals and (voice.locals["dual"] * part).any():
            arrays |= {f"local{k}_{name}": value for name, value in voice.locals.items()}
            arrays[f"local{k}_dual"] = voice.locals["dual"] * part
    return arrays


def condense_corrections(
    arrays: dict[str, FloatArray], sample: FloatArray, *, noise: float
) -> dict[str, FloatArray]:
    """Say the same in fewer kernels, where there are many.

    Parameters
    ----------
    arrays : dict of str to float array
        From `stack_corrections`; others may stand beside them.
    sample : (n, D) float array
        Coordinates of frames that nobody tuned.
    noise : float
        Standard deviation of a coordinate [mm].

    Returns
    -------
    dict of str to float array
        What is to stand beside the arrays; nothing where all of them are as quick.
    """
    kernels = sum(
        int((arrays[f"{name}_dual"] != 0).sum())
        if arrays[f"{name}_projection"].ndim == 3
        else len(arrays[f"{name}_centres"])
        for name in _names(arrays)
    )
    if kernels <= FEW_KERNELS:
        return {}
    condensed = condense(prepare_corrections(arrays), sample, noise=noise)
    return {CONDENSED + name: value for name, value in (condensed or {}).items()}


def prepare_corrections(
    arrays: dict[str, FloatArray], *, single: bool = False, device: ArrayDevice = CPU
) -> Predictor:
    """Make the corrections that a mapping's arrays hold ready for many frames.

    Parameters
    ----------
    arrays : dict of str to float array
        From `stack_corrections` and `condense_corrections`; others may stand beside them.
    single : bool
        Evaluate in single precision where little is lost by it.
    device : ArrayDevice
        Where coordinates will be.
    """
    names = _names(arrays)
    if CONDENSED + "smooth" not in arrays:
        return _sum([_local(arrays, name, 1.0, single, device) for name in names])
    smooth = arrays[CONDENSED + "smooth"]
    own = _sum([_local(arrays, name, 1.0 - smooth, single, device) for name in names])
    asked = _sum([_local(arrays, name, smooth, single, device) for name in names])
    found = CondensedFunction(
        {
            name.removeprefix(CONDENSED): value
            for name, value in arrays.items()
            if name.startswith(CONDENSED)
        },
        single=single,
        device=device,
    )
    return lambda points: found(points, asked) + own(points)


def _names(arrays: dict[str, FloatArray]) -> list[str]:
    """Which voices correct anything."""
    return sorted(
        name.removesuffix("_projection") for name in arrays if name.endswith("_projection")
    )


def _local(
    arrays: dict[str, FloatArray],
    name: str,
    share: FloatArray | float,
    single: bool,
    device: ArrayDevice,
) -> LocalSums:
    """One voice's corrections, of some shapes."""
    heard = arrays | {f"{name}_dual": arrays[f"{name}_dual"] * share}
    return local_sums(heard, prefix=f"{name}_", single=single, device=device)


def _sum(parts: list[LocalSums]) -> Predictor:
    def sums(points: Any) -> Any:
        return sum((part(points) for part in parts[1:]), parts[0](points)) if parts else 0.0

    return sums
