"""Nothing tuned is ever lost: crashes, other writers, other selections."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf

from tests.tuning.small_asset import change, put, small_references, write_asset
from usdface.core.errors import InputError
from usdface.core.provenance import Provenance
from usdface.core.sidecars import tuned_path
from usdface.tuning import session as session_module
from usdface.tuning.journal import Change
from usdface.tuning.session import StaleRevisionError, TuningSession
from usdface.usdio.references.read import WEIGHTS_ATTRIBUTE, read_references
from usdface.usdio.references.weight_layers import TunedPair, read_tuned_pairs
from usdface.usdio.references.write import write_tuned_weights


@pytest.fixture
def asset(tmp_path: Path) -> Path:
    return write_asset(tmp_path)


@pytest.fixture
def session(asset: Path) -> Iterator[TuningSession]:
    opened = TuningSession(asset)
    yield opened
    opened.lock.release()


def crash(session: TuningSession) -> None:
    """What a killed server leaves: its files as they are, its lock of a process that is gone."""
    session.lock.path.unlink()


def weights(path: Path, pair: int) -> list[float]:
    return read_references(path).weights[pair].tolist()


def test_a_saved_change_composes_and_only_its_pair_is_tuned(
    asset: Path, session: TuningSession
) -> None:
    before = read_references(asset)
    put(session, 2, jawOpen=0.5)
    session.save()
    after = read_references(asset)
    assert after.weights[2, 0] == 0.5
    assert after.tuned.tolist() == [False, False, True, False, False]
    others = np.arange(5) != 2
    np.testing.assert_array_equal(after.weights[others], before.weights[others])
    np.testing.assert_array_equal(after.weights[2, 1:], before.weights[2, 1:])


def test_a_change_survives_a_crash_before_it_is_saved(asset: Path, session: TuningSession) -> None:
    put(session, 1, smile=0.75)
    session.apply([replace(change(session, 3), done=True)], revision=session.revision)
    crash(session)
    assert weights(asset, 1)[2] != 0.75
    again = TuningSession(asset)
    assert again.recovered == 2
    assert again.state().weights[1, 2] == 0.75
    assert again.state().done.tolist() == [False, False, False, True, False]
    again.close()
    assert weights(asset, 1)[2] == 0.75
    assert [(p.pair, p.done) for p in read_tuned_pairs(tuned_path(asset))] == [
        (1, False),
        (3, True),
    ]


def test_a_crash_between_writing_the_layer_and_clearing_the_journal_does_no_harm(
    asset: Path, session: TuningSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(session, 1, smile=0.75)
    with monkeypatch.context() as patched:
        patched.setattr(session_module, "flush_folder", lambda folder: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            session.save()
    crash(session)
    again = TuningSession(asset)
    assert again.recovered == 1
    assert again.state().weights[1, 2] == 0.75
    again.close()


def test_a_saved_session_leaves_neither_journal_nor_lock(asset: Path) -> None:
    session = TuningSession(asset)
    put(session, 0, jawOpen=0.1)
    session.close()
    names = {each.name for each in asset.parent.iterdir()}
    assert not {name for name in names if name.endswith((".journal", ".lock"))}


def test_going_back_to_the_proposal_makes_a_pair_a_proposal_again(
    asset: Path, session: TuningSession
) -> None:
    proposed = weights(asset, 4)
    put(session, 4, jawOpen=0.9)
    session.save()
    assert read_references(asset).tuned[4]
    put(session, 4, jawOpen=proposed[0])
    session.save()
    assert not read_references(asset).tuned.any()


def test_a_pair_can_be_done_as_it_was_proposed(asset: Path, session: TuningSession) -> None:
    session.apply([replace(change(session, 0), done=True)], revision=0)
    session.save()
    assert read_references(asset).tuned.tolist() == [True, False, False, False, False]


def test_selecting_again_keeps_touched_pairs_and_who_is_done(asset: Path) -> None:
    session = TuningSession(asset)
    put(session, 1, jawOpen=0.5)
    session.apply([replace(change(session, 2), done=True)], revision=session.revision)
    session.close()
    anew = small_references(asset.parent)
    write_asset(asset.parent, replace(anew, weights=anew.weights * 0.5))
    session = TuningSession(asset)
    state = session.state()
    assert state.weights[1, 0] == 0.5
    assert state.done.tolist() == [False, False, True, False, False]
    np.testing.assert_allclose(state.weights[0], anew.weights[0] * 0.5, atol=1e-7)
    session.close()


def test_weights_imported_while_the_page_is_open_are_kept(
    asset: Path, session: TuningSession
) -> None:
    put(session, 1, jawOpen=0.5)
    references = read_references(asset)
    write_tuned_weights(
        references,
        [TunedPair(3, "kitchen", int(references.frames[3]), {"smile": 0.25})],
        layer_path=tuned_path(asset),
        provenance=Provenance(),
    )
    with pytest.raises(StaleRevisionError, match="changed elsewhere"):
        put(session, 1, jawOpen=0.6)
    put(session, 1, jawOpen=0.6)
    session.save()
    assert weights(asset, 1)[0] == np.float32(0.6)
    assert weights(asset, 3)[2] == 0.25


def test_a_layer_that_another_program_damaged_is_refused_until_it_is_mended(
    asset: Path, session: TuningSession
) -> None:
    put(session, 1, jawOpen=0.5)
    session.save()
    good = tuned_path(asset).read_bytes()
    layer = Sdf.Layer.OpenAsAnonymous(str(tuned_path(asset)))
    layer.SetTimeSample(WEIGHTS_ATTRIBUTE, 3, [0.25, 0.5, 0.75])
    layer.SetTimeSample(WEIGHTS_ATTRIBUTE, 4, [0.5, 0.5])  # for three shapes
    layer.Export(str(tuned_path(asset)))
    damaged = tuned_path(asset).read_bytes()
    for _ in range(2):
        with pytest.raises(InputError, match="time code 4: 2 values for 3 names"):
            put(session, 1, jawOpen=0.6)
        session.save()
        assert tuned_path(asset).read_bytes() == damaged
    tuned_path(asset).write_bytes(good)
    with pytest.raises(StaleRevisionError):
        put(session, 1, jawOpen=0.6)
    put(session, 1, jawOpen=0.6)


def test_frames_selected_again_while_the_page_is_open_stop_it(
    asset: Path, session: TuningSession
) -> None:
    write_asset(asset.parent, small_references(asset.parent, first=500))
    with pytest.raises(InputError, match="selected again while this page was open"):
        put(session, 1, jawOpen=0.5)


def test_a_tuned_layer_of_an_older_selection_is_refused_and_kept(asset: Path) -> None:
    session = TuningSession(asset)
    put(session, 1, jawOpen=0.5)
    session.close()
    old = tuned_path(asset).read_bytes()
    tuned_path(asset).unlink()
    write_asset(asset.parent, small_references(asset.parent, first=500))
    tuned_path(asset).write_bytes(old)
    with pytest.raises(InputError, match=r"was tuned for frame 1\d\d of kitchen.* frame 5\d\d of"):
        TuningSession(asset)
    assert tuned_path(asset).read_bytes() == old
    assert not list(asset.parent.glob("*.lock"))


def test_a_journal_of_an_older_selection_is_refused_and_kept(
    asset: Path, session: TuningSession
) -> None:
    put(session, 1, jawOpen=0.5)
    crash(session)
    write_asset(asset.parent, small_references(asset.parent, take="hall"))
    with pytest.raises(InputError, match=r"made for frame 107 of kitchen.*frame 107 of hall"):
        TuningSession(asset)
    (journal,) = asset.parent.glob("*.journal")
    assert b"0.5" in journal.read_bytes()


def test_a_tuned_layer_of_another_rig_is_refused(asset: Path) -> None:
    session = TuningSession(asset)
    put(session, 1, jawOpen=0.5)
    session.close()
    layer = tuned_path(asset)
    layer.write_text(layer.read_text().replace('"smile"', '"frown"'))
    with pytest.raises(InputError, match=r"without smile: it belongs to another rig"):
        TuningSession(asset)


def test_the_second_person_is_refused_until_taking_over(
    asset: Path, session: TuningSession
) -> None:
    put(session, 1, jawOpen=0.5)
    with pytest.raises(InputError, match="has been tuning it since"):
        TuningSession(asset)
    second = TuningSession(asset, take_over=True)
    assert second.state().weights[1, 0] == 0.5  # not saved as USD yet, and not lost
    with pytest.raises(InputError, match="took it over"):
        put(session, 1, jawOpen=0.9)
    with pytest.raises(InputError, match="took it over"):
        session.save()
    second.close()
    assert weights(asset, 1)[0] == 0.5


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (Change(9, "kitchen", 100), "pair 10, and there are 5"),
        (Change(0, "kitchen", 107), "pair 1 was made for frame 107"),
        (Change(0, "kitchen", 100, {"nose": 0.5}), "'nose', which is not a shape"),
        (Change(0, "kitchen", 100, {"smile": 1e9}), "smile cannot be 1000000000"),
    ],
    ids=["pair", "frame", "shape", "huge"],
)
def test_a_bad_change_is_refused_whole(session: TuningSession, bad: Change, message: str) -> None:
    good = change(session, 2, jawOpen=0.125)
    with pytest.raises(InputError, match=message):
        session.apply([good, bad], revision=0)
    assert session.state().weights[2, 0] != 0.125
    assert session.is_saved


def test_an_import_step_that_was_done_stays_done_after_tuning(asset: Path) -> None:
    from usdface.core.provenance import Provenance
    from usdface.usdio.layers import read_provenance

    references = read_references(asset)
    made = Provenance("references-import", '{"weights":"keys.csv"}', {"keys.csv": "abc"})
    pair = TunedPair(0, "kitchen", 100, {"smile": 0.25})
    write_tuned_weights(references, [pair], layer_path=tuned_path(asset), provenance=made)
    session = TuningSession(asset)
    put(session, 1, jawOpen=0.5)
    session.close()
    after = read_provenance(tuned_path(asset))
    assert after == made


def test_the_author_is_kept_with_the_pairs_that_change(asset: Path) -> None:
    for author, pair in (("anna", 1), ("ben", 2)):
        session = TuningSession(asset, author=author)
        put(session, pair, smile=0.75)
        session.close()
    assert read_references(asset).authors == ("", "anna", "ben", "", "")


def test_who_takes_over_is_not_the_author_of_what_was_not_saved_yet(asset: Path) -> None:
    before = TuningSession(asset, author="anna")
    put(before, 1, smile=0.75)
    session = TuningSession(asset, author="ben", take_over=True)
    put(session, 2, smile=0.75)
    session.close()
    assert read_references(asset).authors == ("", "anna", "ben", "", "")
