"""What a worker must have for each kind of task."""

from dataclasses import dataclass


@dataclass(frozen=True)
class HostRequirements:
    """Least that a task needs.

    Attributes
    ----------
    cores : int
    memory_mib : int
    """

    cores: int
    memory_mib: int


LIGHT = HostRequirements(1, 2048)
"""Steps that stream over frames: memory does not grow with the take."""

_BY_STEP = {
    "clean": HostRequirements(2, 4096),
    "align": HostRequirements(1, 4096),
    "select": HostRequirements(2, 8192),
    "train": HostRequirements(2, 8192),
    "sheet": HostRequirements(2, 4096),
    "movie": HostRequirements(4, 8192),
    "deform": HostRequirements(2, 8192),
    "make-shapes": HostRequirements(2, 8192),
    "train-retarget": HostRequirements(2, 8192),
}


def host_requirements(step: str) -> HostRequirements:
    """Return what a worker must have to run a step."""
    return _BY_STEP.get(step, LIGHT)
