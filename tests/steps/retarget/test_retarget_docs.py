"""Every command on the page about retargeting runs, in its order."""

from pathlib import Path

import numpy as np

from tests.regenerate import REPOSITORY
from tests.test_docs import commands, run
from tests.usdio.small_creature import (
    creature_acts,
    human_moves,
    write_creature,
    write_creature_performance,
    write_human,
    write_human_performance,
)


def test_the_page_about_retargeting_runs(tmp_path: Path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    human, dog = write_human(Path("human.usda")), write_creature(Path("dog.usda"))
    rng = np.random.default_rng(0)
    poses = np.concatenate([np.zeros((1, 3)), np.eye(3), rng.random((20, 3))])
    write_human_performance(Path("kitchen.human.usda"), human, human_moves(200))
    write_human_performance(Path("human_poses.usda"), human, poses, first=1)
    write_creature_performance(Path("dog_poses.usda"), dog, creature_acts(poses))
    write_creature_performance(Path("dog_surprise.usda"), dog, creature_acts(human_moves(50)))
    lines = commands(REPOSITORY / "docs" / "retarget.md")
    assert len(lines) == 12
    for line in lines:
        code = run(line)
        if "--source-rig human.usda --rig" in line:
            assert code == 2
            assert "too flat for a face" in capsys.readouterr().err  # so are these three points
            continue
        assert code == 0, f"{line}\n{capsys.readouterr()}"
    for name in ("kitchen.warped.usda", "kitchen.faces.jpg", "kitchen.cyclic.jpg"):
        assert Path(name).is_file()
