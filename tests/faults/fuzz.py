"""A reader of captures against bytes that a fuzzer steers by what code they reach: `poe fuzz`.

`pip install atheris` first; it is no dependency, as it needs a compiler of its own on many systems.
Whatever the bytes, a take comes out whose promises hold, or our own error. What does not is kept as
a file, and the exit code is not 0.
"""

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

SECONDS = 600
LONGEST_READ = 5
"""Seconds after which a read counts as hanging."""
LARGEST_MEMORY_MB = 4096


def main() -> int:
    """Fuzz one reader for some seconds."""
    try:
        import atheris
    except ImportError:
        sys.stderr.write("atheris is not installed here: pip install atheris\n")
        return 2
    with atheris.instrument_imports(include=["usdface.capture"]):
        from usdface.capture import sniff
    parser = argparse.ArgumentParser(description="Fuzz a reader of captures.")
    parser.add_argument("reader", nargs="?", default="c3d", choices=[f.name for f in sniff.FORMATS])
    parser.add_argument("--seconds", type=int, default=SECONDS)
    parser.add_argument("--kept", type=Path, default=Path("fuzz"), help="folder for what it finds")
    asked = parser.parse_args()
    asked.kept.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as name:
        seeds = Path(name) / "seeds"
        seeds.mkdir()
        for number, content in enumerate(_seeds(asked.reader, Path(name))):
            (seeds / f"{number}").write_bytes(content)
        path = Path(name) / "fuzzed.capture"

        def read(content: bytes) -> None:
            path.write_bytes(content)
            check(path, asked.reader)

        atheris.Setup(
            [
                sys.argv[0],
                str(seeds),
                f"-max_total_time={asked.seconds}",
                f"-timeout={LONGEST_READ}",
                f"-rss_limit_mb={LARGEST_MEMORY_MB}",
                f"-artifact_prefix={asked.kept.resolve()}/",
                "-max_len=8192",
                "-print_final_stats=1",
                "-seed=1",
            ],
            read,
        )
        atheris.Fuzz()  # ends the process
    return 0


def check(path: Path, reader: str) -> None:
    """Read a file; what comes out keeps its promises, or the reader refuses it by name."""
    from usdface.capture.c3d import open_c3d
    from usdface.capture.sniff import read_capture
    from usdface.core.errors import InputError

    try:
        if reader == "c3d":
            file = open_c3d(path)
            file.read_analog()
            file.events()
        take = read_capture(path, format=reader).take
    except InputError as error:
        if path.name not in str(error):
            raise AssertionError(f"does not name the file: {error}") from error
        return
    if take.markers is not None and not np.isfinite(take.markers.positions).all():
        raise AssertionError("a marker is not finite")
    if take.source is not None and not np.isfinite(take.source.values).all():
        raise AssertionError("a weight is not finite")


def _seeds(reader: str, folder: Path) -> list[bytes]:
    """Sound files to begin with."""
    from tests.capture import text_samples
    from tests.capture.test_c3d_damage import sound_file

    if reader == "c3d":
        return [sound_file(), text_samples.c3d(folder)]
    return [text_samples.TEXTS[reader]().encode()]


if __name__ == "__main__":
    sys.exit(main())
