"""Integration of extracted files as a numbered, immutable version."""

import hashlib
import itertools
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from usdface.core.errors import InputError
from usdface.core.provenance import relative_name
from usdface.core.replacing import write_text
from usdface.core.text import json_text
from usdface.core.version import __version__
from usdface.publish.extract import Extracted

MANIFEST_NAME = "publish.json"
_VERSION = re.compile(r"(\.?)v(\d{3,})")
"""Folder of a version; with a dot, the file that marks its number as used, so that after a deletion
caches do not serve it for another version."""


@dataclass(frozen=True)
class Published:
    """A published version."""

    name: str
    version: int
    """From 1."""
    folder: Path
    files: dict[str, Path]
    """By role, as in `Extracted`."""
    is_new: bool = True
    """False if the newest version was equal, and none was made."""


def integrate_performance(extracted: Extracted, *, comment: str = "") -> Published:
    """Publish extracted files as the next version.

    Versions are created by one rename, also with concurrent publishes. Files equal to the newest
    version's are not published again, so that a publish can be retried.

    Parameters
    ----------
    comment : str
        Stored in the version's publish.json.

    Raises
    ------
    InputError
        If the version cannot be made; the extracted files are kept.
    """
    parent = extracted.folder.parent
    hashes = _hashes(extracted.folder, extracted.files)
    newest = latest_version(parent)
    last = latest_version(parent, deleted=True)
    if newest and _holds(parent / _folder_name(newest), extracted.files, hashes):
        extracted.discard()
        return _published(extracted, newest, is_new=False)
    for version in itertools.count(last + 1):
        _write_manifest(extracted, version, hashes, comment)
        try:
            (parent / f".{_folder_name(version)}").touch()
            extracted.folder.rename(parent / _folder_name(version))
        except OSError as error:
            if (parent / _folder_name(version)).exists():
                continue  # a concurrent publish
            raise InputError(
                f"{parent / _folder_name(version)}: cannot be made: {error.strerror}; make the "
                "folder above it writable"
            ) from error
        break
    return _published(extracted, version, is_new=True)


def latest_version(folder: Path, *, deleted: bool = False) -> int:
    """Return the highest version number in an item's folder; 0 if there is none."""
    found = [_VERSION.fullmatch(path.name) for path in folder.iterdir()] if folder.is_dir() else []
    return max((int(match[2]) for match in found if match and (deleted or not match[1])), default=0)


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return the manifest of a published version."""
    file = folder / MANIFEST_NAME
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(
            f"{file}: cannot be read ({error}); is this a published version?"
        ) from error
    files = data.get("files") if isinstance(data, dict) else None
    if not isinstance(files, dict) or not all(isinstance(each, dict) for each in files.values()):
        raise InputError(f"{file}: does not describe a published version; give a version's folder")
    return dict(data)


def _published(extracted: Extracted, version: int, *, is_new: bool) -> Published:
    folder = extracted.folder.parent / _folder_name(version)
    files = {role: folder / name for role, name in extracted.files.items()}
    return Published(extracted.item.name, version, folder, files, is_new)


def _folder_name(version: int) -> str:
    return f"v{version:03}"


def _write_manifest(
    extracted: Extracted, version: int, hashes: dict[str, str], comment: str
) -> None:
    item, folder = extracted.item, extracted.folder
    files = {role: {"name": name, "sha256": hashes[role]} for role, name in extracted.files.items()}
    manifest = {
        "usdface": __version__,
        "name": item.name,
        "version": version,
        "comment": comment,
        "frames": [item.first_frame, item.last_frame],
        "rate": [item.rate.numerator, item.rate.denominator],
        "timecode": item.timecode_start,
        "edited": list(item.edited),
        "verdict": None
        if item.verdict is None
        else {"level": item.verdict.level, "sentence": item.verdict.sentence},
        "performance": relative_name(item.performance, folder),
        "take": None if item.take is None else relative_name(item.take, folder),
        "rig": relative_name(item.rig, folder),
        "files": files,
    }
    write_text(folder / MANIFEST_NAME, json_text(manifest))


def _hashes(folder: Path, files: Mapping[str, str]) -> dict[str, str]:
    return {
        role: hashlib.sha256((folder / name).read_bytes()).hexdigest()
        for role, name in files.items()
    }


def _holds(folder: Path, files: Mapping[str, str], hashes: dict[str, str]) -> bool:
    """Return whether a version has these files; not what its manifest says of lost ones."""
    try:
        stated = read_manifest(folder)["files"]
        return {*stated} == {*files} and _hashes(folder, files) == hashes
    except (InputError, OSError):
        return False
