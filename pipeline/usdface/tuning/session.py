"""Session of the tuning page: weights in memory and journal, saved as USD."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from usdface.core.arrays import BoolArray, FloatArray, index_of
from usdface.core.assets import References
from usdface.core.errors import InputError
from usdface.core.locks import TuningLock, user_name
from usdface.core.provenance import Provenance, canonical_json, hash_files
from usdface.core.sidecars import journal_path, lock_path, proposed_path, tuned_path
from usdface.tuning.journal import Change, Journal, flush_folder
from usdface.usdio.layers import read_provenance
from usdface.usdio.references.read import read_references
from usdface.usdio.references.weight_layers import (
    SAME_WEIGHT,
    TunedPair,
    check_shown,
    check_tuned_layer,
    read_proposals,
    read_tuned_pairs,
)
from usdface.usdio.references.write import write_tuned_layer


class StaleRevisionError(InputError):
    """A change was based on an outdated state."""


@dataclass(frozen=True)
class _State:
    """State shown by a page."""

    revision: int
    """Increases with every change."""
    weights: FloatArray
    proposals: FloatArray
    """`weights`, `proposals`: (pairs, shapes)"""
    tuned: BoolArray
    """(pairs,): whether the weights differ from the proposal, or are marked as done."""
    done: BoolArray
    """(pairs,)"""


class TuningSession:
    """Exclusive editing of a references asset; close it to save and to release the lock.

    Changes are on disk in the journal when `apply` returns; `save` writes them to the tuned layer.
    If another program changes the layer meanwhile, it is read again, and the changes since the last
    save are applied to it. An asset that is locked, or whose tuned layer or journal belongs to
    another selection, is refused; nothing on disk is changed then.

    Parameters
    ----------
    author : str
        Stored with the pairs and places that change; by default the login name.
    take_over : bool
        Take the lock from another session.
    first_revision : int
        Different for each server, so that a page left open over a restart detects it.

    Attributes
    ----------
    references : References
        As at the start of the session.
    revision : int
        Increases with every change.
    recovered : int
        Number of changes that an earlier session had not saved as USD.
    """

    def __init__(
        self, path: Path, *, author: str = "", take_over: bool = False, first_revision: int = 0
    ) -> None:
        self.path = path
        self.author = author or user_name()
        self.tuned_path = tuned_path(path)
        self.references: References = read_references(path)
        check_tuned_layer(self.tuned_path, self.references)
        check_shown(path)
        self._proposals = read_proposals(proposed_path(path), self.references)
        self._column = index_of(self.references.shape_names)
        self._selected = [_signature(path), _signature(proposed_path(path))]
        self._guard = threading.Lock()
        self.revision = first_revision
        self.lock = TuningLock(lock_path(path))
        self.lock.acquire(take_over=take_over)
        try:
            self._journal = Journal(journal_path(path))
            self._unsaved: list[Change] = self._journal.replay()
            self._check_pairs(self._unsaved)
            self.recovered = len(self._unsaved)
            self._read_layer()
        except BaseException:
            self.lock.release()
            raise

    def state(self) -> _State:
        """Return the current state."""
        with self._guard:
            return _State(
                self.revision,
                self._weights.copy(),
                self._proposals,
                self._tuned(),
                self._done.copy(),
            )

    @property
    def is_saved(self) -> bool:
        """Whether every change is in the tuned layer."""
        return not self._unsaved

    def apply(self, changes: Sequence[Change], *, revision: int) -> int:
        """Apply changes and write them to the journal; return the new revision.

        `StaleRevisionError` if another page or program has changed the weights since `revision`, on
        which the changes are based: read the state again.
        """
        with self._guard:
            self.lock.check()
            self._reread_if_changed()
            if revision != self.revision:
                raise StaleRevisionError(
                    f"{self.path.name}: changed elsewhere since revision {revision}; read it again"
                )
            self._check_pairs(changes)
            changes = [replace(change, author=self.author) for change in changes]
            self._journal.append(changes)
            self._unsaved.extend(changes)
            for change in changes:
                self._put(change)
            self.revision += 1
            return self.revision

    def save(self) -> None:
        """Write the tuned layer and clear the journal if there are changes.

        `InputError` if the lock was lost, or the layer cannot be written; the journal is then kept.
        """
        with self._guard:
            if not self._unsaved:
                return
            self.lock.check()
            self._reread_if_changed()
            names = self.references.shape_names
            tuned = [
                TunedPair(
                    pair,
                    self.references.takes[pair],
                    int(self.references.frames[pair]),
                    dict(zip(names, self._weights[pair].tolist(), strict=True)),
                    bool(self._done[pair]),
                    self._authors[pair],
                )
                for pair in np.flatnonzero(self._tuned()).tolist()
            ]
            made = read_provenance(self.tuned_path) if self.tuned_path.is_file() else None
            write_tuned_layer(
                replace(self.references, weights=self._proposals),
                tuned,
                layer_path=self.tuned_path,
                # That of the layer, if it has one, so that jobs do not make it again.
                provenance=made or self.provenance(proposed_path(self.path)),
            )
            flush_folder(self.tuned_path.parent)  # before the journal is removed
            self._journal.clear()
            self._unsaved = []
            self._seen = _signature(self.tuned_path)

    def close(self) -> None:
        """Save, and release the lock."""
        try:
            if self.lock.is_ours():
                self.save()
        finally:
            self.lock.release()

    def _tuned(self) -> BoolArray:
        away = np.abs(self._weights - self._proposals).max(axis=1, initial=0.0)
        return np.asarray(self._done | (away > SAME_WEIGHT))

    def _read_layer(self) -> None:
        """Read the weights from disk and apply unsaved changes."""
        seen = _signature(self.tuned_path)
        weights, tuned = read_references(self.path).weights, read_tuned_pairs(self.tuned_path)
        self._seen = seen  # not of a layer that cannot be read, which would be overwritten
        self._weights: FloatArray = weights.copy()
        self._done: BoolArray = np.zeros(len(weights), dtype=np.bool_)
        self._authors: list[str] = [""] * len(weights)
        for pair in tuned:
            self._done[pair.pair], self._authors[pair.pair] = pair.done, pair.author
        for change in self._unsaved:
            self._put(change)

    def _reread_if_changed(self) -> None:
        """Merge changes by `references import` or a DCC."""
        if self._selected != [_signature(self.path), _signature(proposed_path(self.path))]:
            raise InputError(
                f"{self.path.name}: its frames were selected again while this page was open, so "
                "changes can no longer be saved; what was saved before is kept. Stop `usdface "
                "tune` and start it again"
            )
        if _signature(self.tuned_path) == self._seen:
            return
        check_tuned_layer(self.tuned_path, self.references)
        self._read_layer()
        self.revision += 1

    def _put(self, change: Change) -> None:
        for name, value in change.weights.items():
            self._weights[change.pair, self._column[name]] = value
            self._authors[change.pair] = change.author or self.author
        if change.done is not None:
            self._done[change.pair] = change.done

    def _check_pairs(self, changes: Sequence[Change]) -> None:
        known = self.references
        for change in changes:
            where = f"{self.path.name}: a change of pair {change.pair + 1}"
            if change.pair >= len(known.frames):
                raise InputError(f"{where}, and there are {len(known.frames)}; reload the page")
            shown = (known.takes[change.pair], int(known.frames[change.pair]))
            if (change.take, change.frame) != shown:
                raise InputError(
                    f"{where} was made for frame {change.frame} of {change.take}, and the pair "
                    f"shows frame {shown[1]} of {shown[0]}: it belongs to another selection. "
                    f"Nothing was changed; put that selection back, or move {self._journal.path} "
                    "away to tune without it"
                )
            for name, value in change.weights.items():
                if name not in self._column:
                    raise InputError(f"{where} names {name!r}, which is not a shape of the rig")
                if abs(value) > 100.0:
                    raise InputError(f"{where}: {name} cannot be {value}; keep it near 0 to 1")

    def provenance(self, proposals: Path) -> Provenance:
        """Return the provenance of changes to proposals, a layer."""
        return Provenance(
            step="tune",
            spec=canonical_json({"step": "tune", "references": self.path.name}),
            inputs={proposals.name: hash_files([proposals])},
        )


def _signature(path: Path) -> tuple[int, int, int]:
    try:
        stat = path.stat()
    except FileNotFoundError:
        return (0, 0, 0)
    return (stat.st_mtime_ns, stat.st_size, stat.st_ino)
