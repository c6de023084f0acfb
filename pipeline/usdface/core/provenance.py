"""Provenance of files: the spec that made them and the hashes of its inputs."""

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from usdface.core.confinement import check_may_open
from usdface.core.errors import InputError
from usdface.core.version import __version__


@dataclass(frozen=True)
class Provenance:
    """Provenance stored in a written file."""

    step: str = ""
    """Name of the step that wrote it; empty for a file made by hand."""
    spec: str = ""
    """The step's spec as canonical JSON."""
    inputs: Mapping[str, str] = field(default_factory=dict)
    """Hash of each input file, by its path in the spec."""
    version: str = __version__
    """Version of this package."""

    @property
    def digest(self) -> str:
        """Eight hex digits that depend on the spec and the inputs, for names of files."""
        return hash_text(f"{self.spec}{sorted(self.inputs.items())}")[:8]

    @property
    def metadata(self) -> dict[str, object]:
        """As the metadata of pictures, movies and pages."""
        return {
            "usdface": self.version,
            "step": self.step,
            "spec": self.spec,
            "inputs": dict(self.inputs),
        }


def canonical_json(data: Any) -> str:
    """Return JSON that is equal for equal data."""
    return json.dumps(data, sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def relative_name(path: Path, folder: Path) -> str:
    """Return a path relative to a folder as files store it: with ``/`` on every system."""
    return os.path.relpath(path.resolve(), folder.resolve()).replace(os.sep, "/")


def hash_text(text: str) -> str:
    """Return the SHA-256 of a text, as hex."""
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def hash_files(files: list[Path]) -> str:
    """Return one SHA-256 over the names and contents of files, without their folders.

    Farms have absolute paths where people use relative ones.
    """
    digests = []
    for path in files:
        check_may_open(path)
        try:
            with path.open("rb") as stream:
                content = hashlib.file_digest(stream, "sha256")
        except OSError as error:
            raise InputError(
                f"{path}: cannot be read: {error.strerror}; check its permissions, and that it is "
                "still there"
            ) from error
        digests.append(path.name.encode("utf-8") + b"\0" + content.digest())
    return hashlib.sha256(b"".join(sorted(digests))).hexdigest()
