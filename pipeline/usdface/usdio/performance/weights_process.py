"""Weights of long takes, written by a process of their own.

USD takes samples, and saves, under Python's lock: threads that solve the next frames would stand
still meanwhile, and solving and writing would add up. A second process writes while this one
solves. It gets the layer without its samples as text, then frames as they come, and writes under
the temporary name it is given; the lock and the rename stay here. When this process goes, however
it goes, the other removes what it wrote and goes as well.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path
from typing import IO, Any, Protocol

import numpy as np
from pxr import Sdf

from usdface.core.arrays import Float32Array, FloatArray
from usdface.core.assets import Rig
from usdface.core.errors import InputError
from usdface.core.interpreter import can_start_again
from usdface.core.provenance import Provenance
from usdface.core.replacing import replacing
from usdface.usdio.layers import (
    check_layer_name,
    read_again,
    save_layer,
    usd_errors_as_input_errors,
)
from usdface.usdio.performance.weights_layer import (
    WeightsHeader,
    WeightsWriter,
    check_count,
    without_samples,
    writing_weights,
)

MUCH = 1 << 24
"""Weights from which the third of a second that a process takes to start is worth it."""

SAMPLE_COSTS = 100
"""Weights that cost USD as much as a sample does before there is one in it."""

VALUES_AHEAD = 1 << 21
"""Weights that wait to be written at most: solving goes on while USD saves."""

_LAST_WORDS_SECONDS = 60.0
"""What the process gets to finish a save when it is told to stop."""

_SAMPLES = ("weights", "confidence", "residual_mm")


class FrameWriter(Protocol):
    """What takes solved frames, whichever process writes them."""

    next_frame: int

    def append(
        self,
        weights: FloatArray | Float32Array,
        *,
        confidence: FloatArray | None = None,
        residual_mm: FloatArray | None = None,
    ) -> None:
        """Append frames: (frames, shapes), and if known (frames,) and (frames, regions)."""


@contextlib.contextmanager
def writing_frames(
    path: Path, header: WeightsHeader, rig: Rig, *, provenance: Provenance | None = None
) -> Iterator[FrameWriter]:
    """Write a weights layer frame by frame, by a process of its own where there is much to write.

    The bytes are the same either way. See `weights_layer.writing_weights`. Parts of
    a performance do without: waiting for each to be whole costs what is gained.
    """
    much = header.frame_count * (SAMPLE_COSTS + len(header.shape_names)) >= MUCH
    apart = much and (os.cpu_count() or 1) > 1 and can_start_again()
    writing = _writing_apart if apart else writing_weights
    with writing(path, header, rig, provenance=provenance) as writer:
        yield writer


@contextlib.contextmanager
def _writing_apart(
    path: Path, header: WeightsHeader, rig: Rig, *, provenance: Provenance | None
) -> Iterator["ProcessWriter"]:
    check_layer_name(path)
    with replacing(path) as temporary:
        with usd_errors_as_input_errors(path, "writing it"):
            text = without_samples(header, rig, provenance)
        order = {
            "temporary": str(temporary),
            "path": str(path),
            "header": asdict(header) | {"rate": str(header.rate)},
            "text": text,
        }
        with _started(order, path, header) as writer:
            yield writer
        check_count(path, header, writer.next_frame)
    read_again(path)


@contextlib.contextmanager
def _started(order: dict[str, Any], path: Path, header: WeightsHeader) -> Iterator["ProcessWriter"]:
    """Start the process; it has written all, or is gone, when the block ends."""
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "usdface.usdio.performance.weights_process"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=os.environ | {"PYTHONPATH": os.pathsep.join(_import_path())},
        process_group=0,  # a terminal's Ctrl+C, too, is for the one that solves
    )
    try:
        with ThreadPoolExecutor(1, thread_name_prefix="send") as sender:
            try:
                writer = ProcessWriter(process, sender, path, header)
                writer.send(order)
                yield writer
                writer.finish()
            except BaseException:
                process.terminate()  # before the sender is waited for, which may wait for it
                raise
    finally:
        _end(process)


def _import_path() -> list[str]:
    """Return where this process imports from; an empty name is the folder it is in."""
    there: list[object] = list(sys.path)  # what is no text is ignored, but may be there
    return [str(Path(each).absolute()) for each in there if isinstance(each, str)]


def _end(process: subprocess.Popen[bytes]) -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            with contextlib.suppress(OSError):  # it reads no more
                pipe.close()
    try:
        process.wait(_LAST_WORDS_SECONDS)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


class ProcessWriter:
    """Hands solved frames to the process that writes; made by `writing_frames`."""

    def __init__(
        self,
        process: subprocess.Popen[bytes],
        sender: ThreadPoolExecutor,
        path: Path,
        header: WeightsHeader,
    ) -> None:
        self._process, self._sender, self._path = process, sender, path
        self._under_way: deque[tuple[int, Future[None]]] = deque()
        self._ahead = 0
        self.next_frame = header.first_frame

    def append(
        self,
        weights: FloatArray | Float32Array,
        *,
        confidence: FloatArray | None = None,
        residual_mm: FloatArray | None = None,
    ) -> None:
        """Append frames: (frames, shapes), and if known (frames,) and (frames, regions)."""
        given = zip(_SAMPLES, (weights, confidence, residual_mm), strict=True)
        arrays = {
            name: np.ascontiguousarray(each, dtype=np.float32)
            for name, each in given
            if each is not None
        }
        shapes = {name: each.shape for name, each in arrays.items()}
        self.send(shapes, *arrays.values())
        self.next_frame += len(weights)

    def send(self, told: dict[str, Any], *arrays: Float32Array) -> None:
        """Send a line and what it announces; wait only where much has been sent already.

        Raises
        ------
        InputError
            If the process could not write.
        """
        size = sum(each.size for each in arrays)
        self._under_way.append((size, self._sender.submit(self._write, told, arrays)))
        self._ahead += size
        while self._ahead > VALUES_AHEAD:
            self._wait_for_oldest()

    def finish(self) -> None:
        """Wait until all is written.

        Raises
        ------
        InputError
            If the process could not write.
        """
        self.send({})
        while self._under_way:
            self._wait_for_oldest()
        self._check_end()

    def _write(self, told: dict[str, Any], arrays: tuple[Float32Array, ...]) -> None:
        pipe = self._process.stdin
        assert pipe is not None
        pipe.write(json.dumps(told).encode() + b"\n")
        for each in arrays:
            pipe.write(each.data)
        pipe.flush()

    def _wait_for_oldest(self) -> None:
        size, sent = self._under_way.popleft()
        self._ahead -= size
        try:
            sent.result()
        except OSError as error:
            self._check_end()
            raise InputError(f"{self._path}: the process that writes it is gone") from error

    def _check_end(self) -> None:
        """Hear what the process says at its end."""
        assert self._process.stdout is not None
        said = self._process.stdout.read().decode(errors="replace")
        code = self._process.wait()
        if code:
            raise InputError(
                said
                or f"{self._path}: the process that writes it ended with {code}; was it "
                "stopped, or is the machine out of memory? Nothing under its name was changed"
            )


def write_received(source: IO[bytes]) -> None:
    """Write what another process sends: an order, frames, and an empty line of JSON at the end.

    Raises
    ------
    EOFError
        If it stops before its end.
    InputError
        If the layer cannot be written.
    """
    order = _received_line(source)
    temporary, path = Path(order["temporary"]), Path(order["path"])
    header = WeightsHeader(**order["header"] | {"rate": Fraction(order["header"]["rate"])})
    try:
        with usd_errors_as_input_errors(path, "writing it"):
            layer = Sdf.Layer.CreateNew(str(temporary))
            writer = WeightsWriter(path, layer, header, order["text"])
            while shapes := _received_line(source):
                rows = {name: _received(source, shape) for name, shape in shapes.items()}
                writer.append(
                    rows["weights"],
                    confidence=rows.get("confidence"),
                    residual_mm=rows.get("residual_mm"),
                )
            save_layer(layer, path)
    except BaseException:
        with contextlib.suppress(OSError):  # the folder may be gone as well
            temporary.unlink(missing_ok=True)
        raise


def _received_line(source: IO[bytes]) -> dict[str, Any]:
    line = source.readline()
    if not line.endswith(b"\n"):
        raise EOFError
    told: dict[str, Any] = json.loads(line)
    return told


def _received(source: IO[bytes], shape: tuple[int, ...]) -> Float32Array:
    size = 4 * int(np.prod(shape))
    got = source.read(size)
    if len(got) < size:
        raise EOFError
    return np.frombuffer(got, dtype=np.float32).reshape(shape)


def main() -> None:
    """Be the process that writes."""
    # Where there are no process groups, Ctrl+C comes here too: who solves says when to stop.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    try:
        write_received(sys.stdin.buffer)
    except EOFError:  # nobody is left to tell
        sys.exit(1)
    except InputError as error:
        sys.stdout.buffer.write(str(error).encode())
        sys.exit(1)


if __name__ == "__main__":
    main()
