"""Held-out observations and what was demonstrated there; a real policy as a subject."""

import json

import numpy as np
import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.policies.factory import make_pre_post_processors

from act_chunking_runtime.settings import ExecutionSettings
from lerobot_act_chunking.diagnostics.core.measures import AlohaGraspPoints, measure_of
from lerobot_act_chunking.diagnostics.steps.grid import Cell
from lerobot_act_chunking.diagnostics.steps.sources import hold_out, near_contact
from lerobot_act_chunking.diagnostics.steps.subject import PolicySubject, executed_steps, own_cell
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES
from lerobot_act_chunking.errors import ConfigurationError, DatasetError, FeatureError
from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.policies.diffusion_chunked.modeling_diffusion_chunked import DiffusionChunkedPolicy
from lerobot_act_chunking.policies.loading import LoadedPolicy

S, A, H = 3, 2, 2
LENGTHS = (30, 20, 25)


def write_dataset(folder, lengths=LENGTHS):
    """Actions that count the frames of the whole dataset; states ten times as much."""
    features = {
        "action": {"dtype": "float32", "shape": (A,), "names": ["reach", "gripper"]},
        "observation.state": {"dtype": "float32", "shape": (S,), "names": None},
    }
    dataset = LeRobotDataset.create("me/count", fps=20, features=features, root=folder)
    row = 0
    for length in lengths:
        for _ in range(length):
            action = np.array([row, 0], np.float32)
            dataset.add_frame(
                {"action": action, "observation.state": np.full(S, 10 * row, np.float32), "task": "count"}
            )
            row += 1
        dataset.save_episode()
    dataset.finalize()
    return folder


def config_of(**settings):
    return DiffusionChunkedConfig(
        device="cpu",
        push_to_hub=False,
        n_obs_steps=H,
        horizon=4,
        chunk_stride=2,
        actions_per_token=1,
        dim_model=8,
        n_layers=1,
        use_ema=False,
        input_features={"observation.state": PolicyFeature(FeatureType.STATE, (S,))},
        output_features={"action": PolicyFeature(FeatureType.ACTION, (A,))},
        **settings,
    )


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return write_dataset(tmp_path_factory.mktemp("data") / "count")


def held_out(dataset, *, checkpoint="nowhere", episodes=2, observations=9, n_steps=6, path="given"):
    path = str(dataset) if path == "given" else path
    return hold_out(
        path, str(checkpoint), config_of(), n_steps=n_steps, episodes=episodes, observations=observations
    )


def test_whole_episodes_from_the_end_evenly(dataset):
    found = held_out(dataset)
    assert found.episodes == [1, 2]
    assert found.fps == 20
    rows = found.demonstrated.actions[:, 0, 0]
    possible = [*range(30, 50 - 5), *range(50, 75 - 5)]
    np.testing.assert_array_equal(rows, np.array(possible)[np.linspace(0, 34, 9).round().astype(int)])
    np.testing.assert_array_equal(found.demonstrated.actions[..., 0], rows[:, None] + np.arange(6))
    assert found.demonstrated.near_contact.shape == (9, 6)


def test_observations_belong_to_the_first_action(dataset):
    found = held_out(dataset)
    states = found.observations["observation.state"]
    assert states.shape == (9, H, S)
    rows = found.demonstrated.actions[:, 0, 0]
    np.testing.assert_array_equal(states[:, -1, 0], 10 * rows)
    before = np.where(rows == 30, 30, rows - 1)  # the first frame of an episode has none before it
    np.testing.assert_array_equal(states[:, 0, 0], 10 * before)


def test_fewer_observations_than_asked_for_are_all_there_are(dataset):
    assert len(held_out(dataset, observations=256).demonstrated.actions) == 15 + 20
    assert len(held_out(dataset, episodes=99, observations=256).demonstrated.actions) == 25 + 15 + 20


def test_the_training_dataset_is_the_default_and_is_known_to_be_seen(dataset, tmp_path):
    def train_on(**content):
        (tmp_path / "train_config.json").write_text(
            json.dumps({"dataset": {"root": str(dataset), **content}})
        )

    train_on(episodes=None)
    assert held_out(None, path=None, checkpoint=tmp_path).seen_in_training
    train_on(episodes=[0, 1])
    assert held_out(dataset, checkpoint=tmp_path).seen_in_training
    train_on(episodes=[0])
    assert not held_out(dataset, checkpoint=tmp_path).seen_in_training
    assert not held_out(dataset).seen_in_training


def test_what_cannot_be_held_out_is_refused(dataset, tmp_path):
    with pytest.raises(
        DatasetError, match=r"there is no dataset at .*nowhere: give a LeRobotDataset's folder"
    ):
        held_out(dataset, path=str(tmp_path / "nowhere"))
    with pytest.raises(DatasetError, match="the checkpoint's training dataset is not here"):
        held_out(dataset, path=None, checkpoint=tmp_path)
    with pytest.raises(DatasetError, match="is as long as the 31 control steps of a chunk"):
        held_out(dataset, n_steps=31, episodes=3)
    with pytest.raises(ConfigurationError, match="episodes=0 must be at least 1"):
        held_out(dataset, episodes=0)
    config = config_of()
    config.input_features["observation.effort"] = PolicyFeature(FeatureType.STATE, (S,))
    with pytest.raises(FeatureError, match=r"needs 'observation.effort', but the dataset at .* has action"):
        hold_out(str(dataset), "nowhere", config, n_steps=2, episodes=1, observations=1)


def test_contact_is_where_all_move_slowly_or_a_gripper_moves():
    speed = np.r_[np.full(40, 1.0), np.full(20, 0.1), np.full(40, 1.0)]
    path = np.cumsum(speed)
    still = np.zeros((100, 1))
    one = path[:, None, None]
    near = near_contact(one, still, fps=10)
    assert near[42:58].all()
    assert not near[:39].any()
    assert not near[61:].any()
    busy = np.stack([path, np.arange(100.0)], 1)[..., None]  # the other point goes on
    assert not near_contact(busy, still, fps=10).any()
    gripper = np.where(np.arange(100) >= 20, 1.0, 0.0)[:, None]
    np.testing.assert_array_equal(np.flatnonzero(near_contact(busy, gripper, fps=10)), range(18, 23))


def test_alohas_joints_are_measured_in_space():
    names = list(JOINT_NAMES)
    assert isinstance(measure_of({"names": names, "shape": (14,)}), AlohaGraspPoints)
    assert isinstance(measure_of({"names": {"motors": names}, "shape": (14,)}), AlohaGraspPoints)
    assert measure_of({"names": None, "shape": (2,)}).names == ("action_0", "action_1")
    assert measure_of({"names": ["a", "b"], "shape": (2,)}).names == ("a", "b")


@pytest.mark.parametrize(
    ("settings", "steps"),
    [
        (ExecutionSettings(20, "open_loop", 12), 12),
        (ExecutionSettings(20, "receding", replan_interval=5, latency_steps=2), 7),
        (ExecutionSettings(20, "crossfade", replan_interval=5, crossfade_steps=4), 9),
        (ExecutionSettings(20, "ensemble", 15, 3), 15),
    ],
)
def test_only_steps_that_reach_the_robot_count(settings, steps):
    assert executed_steps(settings) == steps


@pytest.fixture(scope="module")
def subject(dataset):
    torch.manual_seed(0)
    config = config_of(sampler="euler", num_inference_steps=3)
    policy = DiffusionChunkedPolicy(config).eval()
    torch.nn.init.normal_(policy.model.denoiser.contract.weight, std=0.5)
    stats = {
        "observation.state": {"mean": torch.full((S,), 400.0), "std": torch.full((S,), 200.0)},
        "action": {"mean": torch.tensor([5.0, -1.0]), "std": torch.tensor([2.0, 0.1])},
    }
    loaded = LoadedPolicy(policy, *make_pre_post_processors(config, dataset_stats=stats))
    return PolicySubject.observing(loaded, held_out(dataset).observations, n_steps=5)


def test_samples_are_the_policys_in_raw_units(subject):
    policy, preprocess, postprocess = subject.policy
    rows, noise = np.array([4, 0, 7]), torch.randn(2, 3, *subject.noise_shape)
    found = subject.sample(Cell("heun", 4), rows, noise)
    assert found.shape == (2, 3, 5, A)
    raw = preprocess({"observation.state": subject_states(subject)[rows]})
    chunks = policy.predict_samples(raw, 2, noise=noise, sampler="heun", num_inference_steps=4)
    np.testing.assert_allclose(found[1, 2], postprocess(chunks[1, 2, :5]), rtol=1e-5)
    assert np.ptp(found) > 0.1
    assert not np.allclose(found, subject.sample(Cell("euler", 2), rows, noise))


def subject_states(subject):
    return 200 * subject.observations["observation.state"] + 400


def test_blocks_do_not_change_samples(subject, monkeypatch):
    rows, noise = np.arange(9), torch.randn(2, 9, *subject.noise_shape)
    whole = subject.sample(Cell("euler", 3), rows, noise)
    monkeypatch.setattr("lerobot_act_chunking.diagnostics.steps.subject.CHUNKS_AT_ONCE", 8)
    np.testing.assert_allclose(subject.sample(Cell("euler", 3), rows, noise), whole, rtol=1e-5)


def test_time_and_own_cell(subject):
    assert subject.milliseconds(Cell("euler", 2)) > 0
    assert subject.noise_shape == (4, A)
    assert own_cell(subject.policy.policy.config) == Cell("euler", 3)
