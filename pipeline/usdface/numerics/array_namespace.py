"""Where arrays live: in numpy, or in a library that computes on a graphics card.

Code written against the array API (data-apis.org) does not name its library. It asks its arrays::

    device = open_device("cuda")                 # or "cpu", "cuda:1", "torch"
    samples = device.put(samples)                # numpy -> the device
    xp = namespace_of(samples)                   # numpy, or torch or cupy in the array API's words
    mean = xp.mean(xp.exp(samples), axis=0)      # runs where its arrays are
    mean = device.fetch(mean)                    # the device -> numpy

numpy alone serves ``"cpu"``. Other devices need torch or cupy, whichever the machine has, and
array-api-compat, which gives both the standard's names (``pip install usdface[gpu]``). Libraries
are imported when a device is opened, and never otherwise.

In double precision (`ArrayDevice.put` keeps the type it gets) devices agree to rounding. Draw
random numbers with numpy and `put` them: then they agree too.
"""

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class ArrayDevice:
    """A place for arrays.

    Attributes
    ----------
    name : str
        As given to `open_device`.
    namespace : module
        Of the array API.
    device : object
        The library's own word for the place; None where there is only one.
    """

    name: str
    namespace: Any
    device: Any = None

    def put(self, values: Any, *, dtype: str | None = None) -> Any:
        """Copy an array there.

        Parameters
        ----------
        values : array
            numpy's.
        dtype : str, optional
            Name of a type, as ``"float32"``; by default that of `values`.
        """
        if self.namespace is np:
            return np.asarray(values, dtype=dtype)
        found = np.asarray(values)
        kind = getattr(self.namespace, dtype or found.dtype.name)
        # readers may hand out read-only views, which torch warns of
        return self.namespace.asarray(np.array(found), dtype=kind, device=self.device)

    def empty(self, shape: tuple[int, ...], *, dtype: str) -> Any:
        """Reserve memory there."""
        return self.namespace.empty(shape, dtype=getattr(self.namespace, dtype), device=self.device)

    def fetch(self, values: Any) -> NDArray[Any]:
        """Copy an array back to numpy's memory."""
        if isinstance(values, np.ndarray):
            return values
        if hasattr(values, "cpu"):  # torch
            return np.asarray(values.cpu().numpy())
        if hasattr(values, "get"):  # cupy
            return np.asarray(values.get())
        return np.from_dlpack(values)


CPU = ArrayDevice("cpu", np)
"""numpy, which is always there."""


def open_device(name: str = "cpu") -> ArrayDevice:
    """Find the library that computes on a device.

    Parameters
    ----------
    name : str
        ``"cpu"`` is numpy; ``"cuda"`` or ``"cuda:1"`` a graphics card, by torch or else by cupy;
        ``"torch"`` is torch on the processor, for trying the others' way without a card.

    Raises
    ------
    ValueError
        If there is no such device, or no library here that reaches it; the message says what was
        looked for.
    """
    kind, _, index = name.partition(":")
    if name == "cpu":
        return CPU
    if name == "torch":
        return ArrayDevice(name, _compatible("torch", name), "cpu")
    if kind != "cuda" or not (index or kind == name) or not (index or "0").isdecimal():
        raise ValueError(f"no device {name!r}; there are cpu, cuda, cuda:NUMBER and torch")
    tried = []
    for open_card in (_torch_card, _cupy_card):
        try:
            return open_card(name, int(index or 0))
        except ValueError as error:
            tried.append(str(error))
    raise ValueError(f"device {name!r} cannot be used: {'; '.join(tried)}. Use device 'cpu'")


def namespace_of(values: Any) -> Any:
    """Return the array API of the library that an array belongs to."""
    if isinstance(values, np.ndarray | np.generic):
        return np
    # also for libraries that name one themselves: theirs may lack what the standard has since
    return importlib.import_module("array_api_compat").array_namespace(values)


def _torch_card(name: str, index: int) -> ArrayDevice:
    namespace = _compatible("torch", name)
    count = int(namespace.cuda.device_count()) if namespace.cuda.is_available() else 0
    if index >= count:
        raise ValueError(f"torch sees {count} cards")
    return ArrayDevice(name, namespace, f"cuda:{index}")


def _cupy_card(name: str, index: int) -> ArrayDevice:
    namespace = _compatible("cupy", name)
    cuda = namespace.cuda
    try:
        count = int(cuda.runtime.getDeviceCount())
    except cuda.runtime.CUDARuntimeError as error:
        raise ValueError(f"cupy sees no card ({error})") from error
    if index >= count:
        raise ValueError(f"cupy sees {count} cards")
    return ArrayDevice(name, namespace, cuda.Device(index))


def _compatible(library: str, name: str) -> Any:
    try:
        importlib.import_module(library)
    except ImportError as error:
        raise ValueError(
            f"{library} is not installed here (for device {name!r}; pip install {library})"
        ) from error
    try:
        return importlib.import_module(f"array_api_compat.{library}")
    except ImportError as error:
        raise ValueError(
            f"device {name!r} needs array-api-compat; pip install usdface[gpu]"
        ) from error
