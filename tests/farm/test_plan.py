"""What runs at once, what waits, and where the chunks begin."""

import itertools
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from usdface.core.errors import InputError
from usdface.core.sidecars import parts_folder
from usdface.farm.plan import FarmStep, Plan, in_chunks, plan_job
from usdface.specs.base import Spec
from usdface.specs.capture import AlignSpec, CleanSpec, IngestSpec, TrackSpec
from usdface.specs.commands import SubmitSpec
from usdface.specs.job import JobSpec
from usdface.specs.paths import Reads, frame_range
from usdface.specs.performance import JoinSpec, MapSpec, TrainSpec
from usdface.specs.review import MovieJoinSpec, MovieSpec, SheetSpec

SIZES = SubmitSpec(job=Path("/s/j.yaml"), chunk=1000, movie_chunk=500)


def mapped(frames: str | None = None, name: str = "x", chunk: int | None = None) -> MapSpec:
    return MapSpec(
        take=Path(f"/s/{name}.usda"),
        mapping=Path("/s/m.usdc"),
        rig=Path("/s/rig.usd"),
        out=Path(f"/s/{name}.hero.usda"),
        frames=frames,
        chunk=chunk,
    )


def plan(*steps: Spec, there: dict[str, tuple[int, int]] | None = None) -> Plan:
    known = {Path(path): frames for path, frames in (there or {}).items()}
    return plan_job(JobSpec(job="j", steps=steps), SIZES, frames_of=known.get)


def shape(found: Plan) -> dict[str, tuple[int, tuple[str, ...]]]:
    return {step.name: (len(step.tasks), step.needs) for step in found.steps}


def day_of_takes(count: int) -> list[Spec]:
    steps: list[Spec] = []
    for number in range(count):
        take = f"/s/t{number}"
        steps += [
            IngestSpec(sources=(Path(f"{take}.c3d"),), out=Path(f"{take}.raw.usda")),
            CleanSpec(take=Path(f"{take}.raw.usda"), out=Path(f"{take}.usda")),
        ]
    steps.append(TrainSpec(references=Path("/s/r.usda"), out=Path("/s/m.usdc")))
    for number in range(count):
        steps.append(mapped(name=f"t{number}"))
        performance = Path(f"/s/t{number}.hero.usda")
        sheet = Path(f"/s/t{number}.jpg")
        steps.append(SheetSpec(performance=performance, take=Path(f"/s/t{number}.usda"), out=sheet))
    return steps


def test_the_same_step_of_twenty_takes_is_one_farm_step() -> None:
    assert shape(plan(*day_of_takes(20))) == {
        "ingest": (20, ()),
        "train": (1, ()),
        "clean": (20, ("ingest",)),
        "map": (20, ("train", "clean")),
        "sheet": (20, ("clean", "map")),
    }


@pytest.mark.parametrize("takes", [1, 2, 5])
def test_nothing_starts_before_what_it_reads_is_made(takes: int) -> None:
    found = plan(*day_of_takes(takes))
    made_by = {path: step for step in found.steps for task in step.tasks for path in task.changes()}
    for step in found.steps:
        before = set(step.needs)
        for task in step.tasks:
            for path in task.paths(Reads):
                if path in made_by:
                    assert made_by[path].name in before
    names = [step.name for step in found.steps]
    assert all(
        names.index(need) < names.index(step.name) for step in found.steps for need in step.needs
    )


def test_what_is_read_is_not_changed_meanwhile() -> None:
    """Aligning writes into the take: whoever reads it before must be done, whoever after, wait."""
    take = Path("/s/t.usda")
    found = plan(
        CleanSpec(take=take, out=Path("/s/early.usda")),
        AlignSpec(take=take),
        CleanSpec(take=take, out=Path("/s/late.usda")),
    )
    assert shape(found) == {
        "clean": (1, ()),
        "align": (1, ("clean",)),
        "clean-2": (1, ("align",)),
    }


@settings(deadline=None)  # a busy machine is no fault
@given(st.integers(-500, 10**6), st.integers(0, 5000), st.integers(1, 2000))
def test_chunks_cover_every_frame_once(first: int, more: int, size: int) -> None:
    last = first + more
    tasks = in_chunks(mapped(), SIZES.model_copy(update={"chunk": size}), (first, last))
    if len(tasks) == 1:
        assert more < size
        assert tasks == [mapped()]
        return
    *parts, join = tasks
    covered = [frame_range(part.frames) for part in parts]
    assert covered[0][0] == first
    assert covered[-1][1] == last
    assert all(a[1] + 1 == b[0] for a, b in itertools.pairwise(covered))
    assert all(b - a + 1 == size for a, b in covered[:-1])
    assert isinstance(join, JoinSpec)
    assert join.parts == tuple(part.out for part in parts)
    assert len(set(join.parts)) == len(parts)
    assert {path.parent for path in join.parts} == {parts_folder(join.out)}


def test_a_take_that_lies_there_is_mapped_in_chunks_and_joined() -> None:
    found = plan(mapped(), there={"/s/x.usda": (1, 2500)})
    assert shape(found) == {"map": (3, ()), "join": (1, ("map",))}
    assert found.whole == ()
    assert [task.frames for task in found.steps[0].tasks] == ["1-1000", "1001-2000", "2001-2500"]


def test_a_take_that_the_job_makes_anew_is_not_cut_by_the_frames_of_the_old_one() -> None:
    clean = CleanSpec(take=Path("/s/raw.usda"), out=Path("/s/x.usda"))
    found = plan(clean, mapped(), there={"/s/x.usda": (1, 2500)})
    assert shape(found) == {"clean": (1, ()), "map": (1, ("clean",))}
    assert found.whole == (Path("/s/x.hero.usda"),)
    known = plan(clean, mapped("1-2500"), there={})
    assert shape(known) == {"clean": (1, ()), "map": (3, ("clean",)), "join": (1, ("map",))}


def test_a_performance_that_shall_lie_in_parts_is_joined_in_parts() -> None:
    *parts, join = in_chunks(mapped(chunk=700), SIZES, (1, 2500))
    assert join.clips == "always"
    assert {part.chunk for part in parts} == {None}


def test_a_video_is_looked_at_in_parts_and_the_take_is_made_of_them() -> None:
    step = TrackSpec(video=Path("/s/x.mp4"), out=Path("/s/x.take.usda"), performer="Kim")
    tracked = SIZES.model_copy(update={"track_chunk": 500})
    *parts, take = in_chunks(step, tracked, (1, 1200))
    assert [part.frames for part in parts] == ["1-500", "501-1000", "1001-1200"]
    assert all(part.part and not part.performer for part in parts)
    assert take == step.model_copy(update={"parts": tuple(part.out for part in parts)})
    several = step.model_copy(update={"views": (Path("/s/y.mp4"),), "calibration": Path("/s/c")})
    assert in_chunks(several, tracked, (1, 1200)) == [several]
    assert in_chunks(step, SIZES, (1, 1200)) == [step]
    assert in_chunks(step, tracked, (1, 500)) == [step]


def test_a_movie_is_drawn_in_pieces_of_the_frames_that_will_be_mapped() -> None:
    movie = MovieSpec(
        performance=Path("/s/x.hero.usda"), take=Path("/s/x.usda"), out=Path("/s/x.mp4")
    )
    found = plan(mapped("101-1300"), movie, there={"/s/x.usda": (1, 9000)})
    assert shape(found) == {
        "map": (2, ()),
        "join": (1, ("map",)),
        "movie": (3, ("join",)),
        "movie-join": (1, ("movie",)),
    }
    steps: dict[str, FarmStep] = {step.name: step for step in found.steps}
    drawn = steps["movie"].tasks
    assert [part.frames for part in drawn] == ["101-600", "601-1100", "1101-1300"]
    assert not any(part.sound for part in drawn), "sound in parts would have seams"
    (joined,) = steps["movie-join"].tasks
    assert isinstance(joined, MovieJoinSpec)
    assert joined.take == Path("/s/x.usda")


def test_a_movie_in_pieces_has_the_sound_of_the_mapped_take_or_is_not_cut() -> None:
    step = mapped("101-1300")
    movie = MovieSpec(performance=step.out, out=Path("/s/x.mp4"))
    joined = [each.tasks for each in plan(step, movie).steps if each.name == "movie-join"]
    assert [each.take for each in joined[0]] == [step.take]
    silent = movie.model_copy(update={"sound": False})
    joined = [each.tasks for each in plan(step, silent).steps if each.name == "movie-join"]
    assert [each.take for each in joined[0]] == [None]
    other = MovieSpec(performance=Path("/s/other.usda"), out=Path("/s/x.mp4"))
    whole = plan(step, other, there={"/s/other.usda": (1, 9000)})
    assert "movie-join" not in shape(whole)


@pytest.mark.parametrize("step", [mapped("1-1000"), mapped("1-3")])
def test_a_take_of_one_chunk_stays_whole(step: MapSpec) -> None:
    assert shape(plan(step)) == {"map": (1, ())}


def test_frames_that_slipped_are_refused_and_not_cut_into_millions_of_tasks() -> None:
    with pytest.raises(InputError, match=r"frames 1-1000000000000 are 1000000000 chunks of 1000"):
        in_chunks(mapped(), SIZES, (1, 10**12))
