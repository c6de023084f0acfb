"""Find the take and the mapping that a performance was made from."""

from pathlib import Path

from usdface.core.assets import References, TrainedMapping
from usdface.core.errors import InputError
from usdface.runner.origin import spec_of
from usdface.usdio.layers import read_provenance
from usdface.usdio.mapping import read_mapping
from usdface.usdio.take.read import TakeReader


def find_take_and_mapping(
    performance: Path, old: References, *, take: Path | None, mapping: Path | None
) -> tuple[TakeReader, TrainedMapping | None]:
    """Return take and mapping, from new paths or by the provenance of a performance or its parts.

    References of takes that carry weights have no mapping.
    """
    if old.source is not None:
        source = _spec_of(performance, "retarget").get("source")
        if take is None and not isinstance(source, str):
            raise InputError(
                f"{performance}: does not name the take it was retargeted from; give it by "
                "--take, or give a performance that `usdface retarget` wrote of a take"
            )
        named = performance.resolve().parent / str(source)
        return TakeReader(take or _present(performance, "take", named)), None
    file, spec = performance, _spec_of(performance, "map")
    seen = set[Path]()
    while not spec and file not in seen:
        seen.add(file)
        parts = _spec_of(file, "join").get("parts")
        if isinstance(parts, list) and parts:
            part = file.resolve().parent / str(parts[0])
            if part.is_file():
                file, spec = part, _spec_of(part, "map")
    paths: dict[str, Path] = {}
    for name, given in (("take", take), ("mapping", mapping)):
        if given is None and name not in spec:
            raise InputError(
                f"{performance}: does not name the {name} it was made from; give it by --{name}, "
                "or give a performance that `usdface map` wrote, or one joined from such parts "
                "that still exist"
            )
        named = file.resolve().parent / str(spec.get(name))
        paths[name] = given or _present(performance, name, named)
    return TakeReader(paths["take"]), read_mapping(paths["mapping"])


def _present(performance: Path, what: str, file: Path) -> Path:
    if file.is_file():
        return file
    raise InputError(
        f"{performance}: its {what}, {file}, is gone; put it back, or give its new path by --{what}"
    )


def _spec_of(file: Path, step: str) -> dict[str, object]:
    """Return the spec of a file made by `step`; empty if another step made it."""
    made = read_provenance(file)
    return spec_of(made) if made is not None and made.step == step else {}
