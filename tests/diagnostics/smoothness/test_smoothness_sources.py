"""Checkpoints and datasets as sources of episodes, compared in one table."""

import json

import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.scripts.lerobot_eval import rollout as lerobot_rollout
from small_policies import JOINTS, make_policy, save

from lerobot_act_chunking.diagnostics.core.environments import environment_of, task_environment
from lerobot_act_chunking.diagnostics.core.rollouts import roll_out
from lerobot_act_chunking.diagnostics.smoothness.comparison import compare, source_names
from lerobot_act_chunking.diagnostics.smoothness.settings import EvaluationSpec
from lerobot_act_chunking.diagnostics.smoothness.sources import (
    action_std,
    holds_datasets,
    read_dataset,
    run_checkpoint,
)
from lerobot_act_chunking.envs.aloha.tasks import JOINT_NAMES
from lerobot_act_chunking.envs.configuration_envs import AlohaSimEnvConfig
from lerobot_act_chunking.errors import ConfigurationError, DatasetError, FeatureError

NAMES = ["waist", "elbow", "gripper"]


def write_dataset(folder, lengths=(20, 31), names=NAMES, state=True, action="action"):
    """Episodes of two speeds; the state lags one step behind."""
    vector = {"dtype": "float32", "shape": (len(names),), "names": names}
    features = {action: vector, "next.success": {"dtype": "bool", "shape": (1,), "names": None}}
    if state:
        features["observation.state"] = vector
    dataset = LeRobotDataset.create(f"me/{folder.name}", fps=25, features=features, root=folder)
    for episode, length in enumerate(lengths):
        t = np.arange(-1, length)[:, None] * 0.04
        path = np.sin((episode + 1) * t * [1.0, 2.0, 3.0][: len(names)]).astype(np.float32)
        for step in range(length):
            frame = {action: path[step + 1], "next.success": np.array([episode == 1 and step == length - 1])}
            if state:
                frame["observation.state"] = path[step]
            dataset.add_frame({**frame, "task": "wave"})
        dataset.save_episode()
    dataset.finalize()
    return str(folder)


def test_a_dataset_gives_its_episodes(tmp_path):
    path = write_dataset(tmp_path / "waves")
    source = read_dataset(path, replan_interval=7)
    assert list(source.joint_names) == NAMES
    assert source.knows_success
    assert [rollout.success for rollout in source.rollouts] == [False, True]
    assert [len(rollout.commands) for rollout in source.rollouts] == [20, 31]
    assert [rollout.seed for rollout in source.rollouts] == [0, 1]
    for rollout in source.rollouts:
        assert rollout.dt == pytest.approx(0.04)
        np.testing.assert_array_equal(rollout.commands[:-1], rollout.positions[1:])
        assert rollout.commands[3, 1] == pytest.approx(np.sin((rollout.seed + 1) * 0.12 * 2.0))
    assert [inference.step for inference in source.rollouts[0].inferences] == [0, 7, 14]
    commands = np.concatenate([rollout.commands for rollout in source.rollouts])
    np.testing.assert_allclose(source.action_std, commands.std(0), rtol=1e-4)
    assert read_dataset(path).rollouts[0].inferences == ()


def test_a_dataset_without_states_still_has_commands(tmp_path):
    source = read_dataset(write_dataset(tmp_path / "waves", state=False))
    assert source.rollouts[0].positions.shape == (20, 0)


def test_a_checkpoint_is_run_as_roll_out_runs_it(tmp_path):
    policy = make_policy(n_action_steps=5, latency_steps=0)
    path = save(policy, tmp_path / "policy")
    finished = []
    spec = EvaluationSpec(task_environment("transfer_cube"), episodes=2, seed=1003)
    source = run_checkpoint(path, spec, finished.append)
    env_config = environment_of(policy.policy.config, task_environment("transfer_cube", "touch"))
    expected = roll_out(policy, env_config, [1003, 1004])
    for one, other in zip(source.rollouts, expected, strict=True):
        np.testing.assert_array_equal(one.commands, other.commands)
    np.testing.assert_allclose(source.action_std, np.full(JOINTS, 0.05))
    np.testing.assert_allclose(action_std(policy), np.full(JOINTS, 0.05))
    assert source.joint_names == JOINT_NAMES
    assert finished[-1] == 2


def test_what_lerobot_eval_records_is_read_like_the_rollout_itself(tmp_path):
    policy = make_policy(n_action_steps=5)
    env_config = AlohaSimEnvConfig(task="transfer_cube", obs_type="state", episode_length=23)
    env = next(iter(env_config.create_envs(2).values()))[0]
    lerobot_rollout(
        env,
        policy.policy,
        *env_config.get_env_processors(),
        policy.preprocessor,
        policy.postprocessor,
        seeds=[1000, 1001],
        recording_dir=tmp_path / "recordings" / "aloha_sim_0",
        env_features=env_config.features,
    )
    env.close()
    source = read_dataset(str(tmp_path / "recordings"), replan_interval=5)
    assert source.joint_names == list(JOINT_NAMES)
    for recorded, rolled in zip(source.rollouts, roll_out(policy, env_config, [1000, 1001]), strict=True):
        np.testing.assert_array_equal(recorded.commands, rolled.commands.astype(float))
        np.testing.assert_allclose(recorded.positions, rolled.positions, atol=1e-6)
        assert [i.step for i in recorded.inferences] == [i.step for i in rolled.inferences]


def test_sources_are_measured_in_the_first_ones_units(tmp_path):
    quick, slow = write_dataset(tmp_path / "quick", (40, 40)), write_dataset(tmp_path / "slow", (90, 20))
    together = compare([quick, slow], EvaluationSpec(), replan_interval=8)
    alone = [compare([path], EvaluationSpec(), replan_interval=8)[0] for path in (quick, slow)]
    assert [report.name for report in together] == ["quick", "slow"]
    assert together[0].commanded == alone[0].commanded
    assert together[1].commanded.arms.rms_jerk != alone[1].commanded.arms.rms_jerk
    for name in NAMES:
        jerks = [report.commanded.joints[name].rms_jerk for report in (together[1], alone[1])]
        assert jerks[0] == pytest.approx(jerks[1])
    assert [report.successes for report in together] == [1, 1]


def test_sources_with_other_joints_do_not_compare(tmp_path):
    paths = [
        write_dataset(tmp_path / "one"),
        write_dataset(tmp_path / "two", names=["waist", "wrist", "gripper"]),
    ]
    with pytest.raises(
        FeatureError, match="one moves waist, elbow, gripper; two waist, wrist, gripper: only"
    ):
        compare(paths, EvaluationSpec())


def test_datasets_of_different_robots_in_one_folder_are_refused(tmp_path):
    for name, joints in (("a", NAMES), ("b", NAMES[:2])):
        write_dataset(tmp_path / "robots" / name, names=joints)
    with pytest.raises(FeatureError, match=r"of different robots, .*: a 3 at 25 Hz, b 2 at 25 Hz;"):
        compare([str(tmp_path / "robots")], EvaluationSpec())


def test_progress_names_the_checkpoint(tmp_path):
    path = save(make_policy(n_action_steps=5), tmp_path / "policy")
    seen = []
    compare([path], EvaluationSpec(episodes=2), progress=lambda name, finished: seen.append((name, finished)))
    assert seen[-1] == ("policy", 2)


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (["out/cube/train/checkpoints/004000/pretrained_model"], ["004000"]),
        (["out/cube/dataset", "out/cube/train/checkpoints/last/pretrained_model"], ["dataset", "last"]),
        (
            ["out/a/checkpoints/last/pretrained_model", "out/b/checkpoints/last/pretrained_model"],
            ["a/last", "b/last"],
        ),
        (["me/act", "me/act_2"], ["act", "act_2"]),
        (["me/act", "me/act"], ["me/act", "me/act"]),
        (["pretrained_model"], ["pretrained_model"]),
    ],
)
def test_names_tell_sources_apart(paths, names):
    assert source_names(paths) == names


def test_folders_are_told_apart(tmp_path):
    checkpoint = save(make_policy(), tmp_path / "policy")
    assert not holds_datasets(checkpoint)
    assert not holds_datasets("me/on_the_hub")
    assert holds_datasets(write_dataset(tmp_path / "waves"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match=r"empty holds neither a checkpoint \(config.json.*nor a dataset"):
        holds_datasets(str(tmp_path / "empty"))


def test_datasets_that_cannot_be_used_are_refused(tmp_path):
    with pytest.raises(DatasetError, match=r"there is no dataset at .*nowhere"):
        read_dataset(str(tmp_path / "nowhere"))
    without = write_dataset(tmp_path / "without", action="observation.velocity")
    with pytest.raises(
        DatasetError, match=r"without has no 'action'; it has observation.velocity, next.success"
    ):
        read_dataset(without)
    path = write_dataset(tmp_path / "waves")
    with pytest.raises(ConfigurationError, match="replan_interval=0 must be at least 1"):
        read_dataset(path, replan_interval=0)
    with pytest.raises(DatasetError, match="at least 2 episodes, got 1"):
        compare([write_dataset(tmp_path / "single", (20,))], EvaluationSpec())
    info = tmp_path / "waves" / "meta" / "info.json"
    info.write_text(json.dumps({}))
    with pytest.raises(DatasetError, match="waves cannot be read"):
        read_dataset(path)


def test_settings_that_make_no_sense_are_refused(tmp_path):
    with pytest.raises(ConfigurationError, match="episodes=1: smoothness needs at least 2"):
        EvaluationSpec(episodes=1)
    with pytest.raises(ConfigurationError, match="replan_interval=5 is for datasets"):
        compare([save(make_policy(), tmp_path / "policy")], EvaluationSpec(), replan_interval=5)
    with pytest.raises(ConfigurationError, match=r"there is no checkpoint at \./nowhere"):
        compare(["./nowhere"], EvaluationSpec())
