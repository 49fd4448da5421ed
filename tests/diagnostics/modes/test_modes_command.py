"""``act-chunking modes`` as a user meets it: untrained policies of every type, and demonstrations."""

import json

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.factory import get_policy_class, make_pre_post_processors
from planted_gates import demonstrations, of_shares
from policy_case import KINDS
from policy_cases import LENGTHS, TYPES
from tiers import full_tier

from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.envs.three_gates.world import GATES

CHUNK, EPISODES = 16, 40
INPUTS = {
    "observation.state": PolicyFeature(FeatureType.STATE, (2,)),
    "observation.environment_state": PolicyFeature(FeatureType.ENV, (6,)),
}
SEEN = {
    "observation.state": INPUTS["observation.state"],
    "observation.images.top": PolicyFeature(FeatureType.VISUAL, (3, 96, 96)),
}
SHOWN = ("--env.obs_type=pixels_state", "--env.observation_height=96", "--env.observation_width=96")
LEROBOTS = {
    "act": (
        INPUTS,
        {"chunk_size": CHUNK, "n_action_steps": 8, "dim_model": 16, "n_heads": 2, "dim_feedforward": 16},
        (),
    ),
    "diffusion": (
        INPUTS,
        {"horizon": CHUNK, "n_action_steps": 8, "down_dims": (16, 32), "num_inference_steps": 2},
        (),
    ),
    "vqbet": (
        SEEN,
        {
            "action_chunk_size": CHUNK,
            "pretrained_backbone_weights": None,
            "gpt_n_layer": 1,
            "gpt_n_head": 2,
            "gpt_hidden_dim": 16,
            "gpt_output_dim": 16,
        },
        SHOWN,
    ),
}
"""Of each type what it observes, its settings, and fields of the environment."""
OURS = [name for name in TYPES if "preset" in PreTrainedConfig.get_choice_class(name).__dataclass_fields__]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    folder = tmp_path_factory.mktemp("gates") / "dataset"
    shown = demonstrations(of_shares(EPISODES))
    sizes = {"action": 2, "observation.state": 2, "observation.environment_state": 6}
    features = {key: {"dtype": "float32", "shape": (n,), "names": None} for key, n in sizes.items()}
    data = LeRobotDataset.create("me/gates", fps=10, features=features, root=folder, use_videos=False)
    for motion in shown.motions:
        for action in motion * shown.unit:
            gates = (GATES - action).ravel()
            frame = {"action": action, "observation.state": action, "observation.environment_state": gates}
            data.add_frame({key: each.astype(np.float32) for key, each in frame.items()} | {"task": "leave"})
        data.save_episode()
    data.finalize()
    modes = [{"episode_index": i, "details": {"mode": int(m)}} for i, m in enumerate(shown.modes)]
    (folder / "meta/recording.json").write_text(json.dumps({"episodes": modes}))
    return folder


def checkpoint(folder, dataset, kind, inputs=INPUTS, **settings):
    torch.manual_seed(0)
    sizes = {**KINDS[kind].sizes, LENGTHS[kind]: CHUNK} if kind in OURS else {}
    config = PreTrainedConfig.get_choice_class(kind)(
        device="cpu",
        push_to_hub=False,
        input_features=dict(inputs),
        output_features={"action": PolicyFeature(FeatureType.ACTION, (2,))},
        **{**sizes, **settings},
    )
    policy = get_policy_class(kind)(config)
    if kind == "vqbet":  # it warns as long as its tokenizer is not trained
        policy.vqbet.action_head.vqvae_model.discretized.fill_(True)
    stats = {
        key: {
            "mean": torch.zeros(n),
            "std": torch.full((n,), 0.2),
            "min": torch.full((n,), -0.5),
            "max": torch.full((n,), 0.5),
        }
        for key, n in (("action", 2), ("observation.state", 2), ("observation.environment_state", 6))
    }
    for part in (policy, *make_pre_post_processors(config, dataset_stats=stats)):
        part.save_pretrained(folder)
    training = {"dataset": {"repo_id": "me/gates", "root": str(dataset)}}
    (folder / "train_config.json").write_text(json.dumps(training))
    return str(folder)


def modes(place, tmp_path, *arguments):
    asked = ["--env.type=three_gates", "--episodes=8", "--samples=3", "--json", str(tmp_path / "modes.json")]
    status = main(["modes", place, *asked, *arguments])
    return status, json.loads((tmp_path / "modes.json").read_text())


@pytest.mark.parametrize("kind", OURS)
def test_every_type_is_counted_and_looked_into(kind, dataset, tmp_path):
    status, content = modes(checkpoint(tmp_path / "policy", dataset, kind), tmp_path)
    assert status == 10  # eight episodes are too few for a way that is shown twice in forty
    assert content["proportions"] == [0.8, 0.15, 0.05]
    assert content["source"] == "recording"
    assert content["episodes"]["n"] == 8
    assert content["chunks"]["n"] == EPISODES * content["chunks"]["per_start"]
    assert content["reasons"][0].startswith("the policy at")  # untrained


@full_tier
@pytest.mark.parametrize("kind", LEROBOTS)
def test_lerobots_own_policies_show_their_ways_and_their_first_chunks(kind, dataset, tmp_path):
    inputs, sizes, fields = LEROBOTS[kind]
    status, content = modes(
        checkpoint(tmp_path / "policy", dataset, kind, inputs, **sizes), tmp_path, *fields
    )
    assert (status, content["policy_type"], content["episodes"]["n"]) == (10, kind, 8)
    assert content["told_by"] == "environment"
    assert content["chunks"]["per_start"] == 1
    assert content["chunks"]["n"] == 8


@pytest.mark.parametrize("kind", [each for each in OURS if each.startswith("act")])
def test_a_latent_is_decoded_from_everywhere(kind, dataset, tmp_path):
    place = checkpoint(tmp_path / "policy", dataset, kind, use_vae=True, z_inference="sample")
    _, content = modes(place, tmp_path, "--out", str(tmp_path / "modes.png"))
    inside = content["inside"]
    assert {"kl", "active_units", "errors", "reconstructed", "prior", "posterior", "likeliest"} <= {*inside}
    assert inside["prior"]["n"] == inside["posterior"]["n"] == 4 * EPISODES
    assert all(error > 0 for error in inside["errors"])
    assert (tmp_path / "modes.png").is_file()


@pytest.mark.parametrize("kind", [each for each in OURS if each.startswith("vqbet")])
def test_codes_are_those_of_the_demonstrations(kind, dataset, tmp_path):
    _, content = modes(checkpoint(tmp_path / "policy", dataset, kind), tmp_path)
    assert len(content["inside"]["used"]) == len(content["inside"]["reconstructed"]) == 3
    assert min(content["inside"]["used"]) >= 1


def test_shares_replace_those_of_the_dataset(dataset, tmp_path):
    place = checkpoint(tmp_path / "policy", dataset, OURS[0])
    _, content = modes(place, tmp_path, "--shares", "50,25,25")
    assert (content["source"], content["proportions"]) == ("shares", [0.5, 0.25, 0.25])


def test_an_environment_is_needed(tmp_path, capsys):
    assert main(["modes", str(tmp_path)]) == 1
    assert "--env.type" in capsys.readouterr().err
