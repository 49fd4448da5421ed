"""The command; what it writes and refuses is tested beside the parity with LeRobot (tests/parity)."""

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.act.configuration_act import ACTConfig
from lerobot.policies.act.modeling_act import ACTPolicy
from lerobot.policies.factory import make_pre_post_processors

from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.policies.loading import load_policy


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("act") / "pretrained_model"
    config = ACTConfig(
        input_features={
            "observation.state": PolicyFeature(FeatureType.STATE, (6,)),
            "observation.environment_state": PolicyFeature(FeatureType.ENV, (7,)),
        },
        output_features={"action": PolicyFeature(FeatureType.ACTION, (4,))},
        device="cpu",
        dim_model=16,
        n_heads=2,
        dim_feedforward=24,
        chunk_size=9,
        n_action_steps=5,
    )
    statistics = {
        key: {"mean": torch.zeros(n), "std": torch.full((n,), 2.0)}
        for key, n in (("observation.state", 6), ("action", 4))
    }
    for part in (ACTPolicy(config), *make_pre_post_processors(config, dataset_stats=statistics)):
        part.save_pretrained(folder)
    return folder


def test_it_says_what_it_made_and_what_to_do_next(checkpoint, tmp_path, capsys):
    out = tmp_path / "runs" / "imported"
    assert main(["import", str(checkpoint), "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "imported: chunks of 9 control steps; execution=open_loop, a new chunk every 5 steps" in printed
    assert "compared with LeRobot's: normalised actions for a random batch differ by " in printed
    assert f"evaluate it: lerobot-eval --policy.path={out} --env.type=" in printed
    assert load_policy(out).policy.config.type == "act_chunked"
    assert [path.name for path in out.parent.iterdir()] == ["imported"]


def test_what_cannot_be_imported_is_an_error_without_a_traceback(tmp_path, capsys):
    assert main(["import", str(tmp_path / "nothing"), "--out", str(tmp_path / "out")]) == 1
    assert "there is no folder" in capsys.readouterr().err
    assert main(["import", str(tmp_path), "--out", str(tmp_path / "out")]) == 1
    assert "holds no config.json" in capsys.readouterr().err
