"""The names that ``import lerobot_act_chunking as ac`` offers."""

import inspect
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import lerobot_act_chunking as ac

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("name", [name for name in ac.__all__ if name != "__version__"])
def test_every_public_name_is_there_and_documented(name):
    assert inspect.getdoc(getattr(ac, name))
    assert getattr(ac, name) is getattr(ac, name)


def test_the_public_names_are_all_that_the_package_lists():
    assert dir(ac) == ac.__all__ == sorted(ac.__all__)
    assert set(ac._MODULE_OF) | {"__version__"} == set(ac.__all__)


def test_the_version_is_the_distributions():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert ac.__version__ == project["version"]


def test_an_unknown_name_is_an_attribute_error_that_lists_the_others():
    with pytest.raises(AttributeError, match=r"no attribute 'load_polcy'; it has: .*load_policy"):
        _ = ac.load_polcy


def test_the_package_says_that_it_is_typed():
    assert (ROOT / "lerobot_act_chunking" / "py.typed").is_file()


def test_listing_the_names_imports_nothing():
    program = """
import sys
import lerobot_act_chunking as ac
dir(ac), ac.__all__, ac.__version__
print(sorted({"torch", "lerobot", "mujoco"} & set(sys.modules)))
from lerobot_act_chunking import make_env, ConfigurationError
print(sorted({"torch", "lerobot", "mujoco"} & set(sys.modules)))
"""
    done = subprocess.run(
        [sys.executable, "-c", program], check=True, capture_output=True, text=True, timeout=120
    )
    assert done.stdout.splitlines() == ["[]", "[]"]


def test_an_environment_is_ready_to_step():
    env = ac.make_env("insertion", obs_type="state", success="hold")
    observation, _ = env.reset(seed=3)
    assert {key: value.shape for key, value in observation.items()} == {
        "agent_pos": (14,),
        "environment_state": (14,),
    }
    _, reward, _, _, info = env.step(env.action_space.sample())
    env.close()
    assert reward == 0
    assert info["is_success"] is False


@pytest.mark.parametrize(
    ("task", "options", "message"),
    [
        (
            "transfer_cubes",
            {},
            "choose one of: transfer_cube, insertion, transfer_modes, language_transfer, pick_place, stack, ",
        ),
        ("insertion", {"success": "any"}, "unknown success rule 'any'; choose one of: touch, hold"),
    ],
)
def test_an_environment_that_cannot_be_made_is_refused(task, options, message):
    with pytest.raises(ac.ConfigurationError, match=message):
        ac.make_env(task, **options)


class Recorder:
    """Stands for a policy and its processors; keeps what it was given."""

    def __init__(self):
        self.batches, self.n_resets = [], 0

    def reset(self):
        self.n_resets += 1

    def select_action(self, batch):
        self.batches.append(batch)
        return batch["observation.state"][:, :2] + 1


def test_a_loaded_policy_acts_on_what_an_environment_returns():
    policy = Recorder()
    loaded = ac.LoadedPolicy(
        policy, preprocessor=lambda batch: batch, postprocessor=lambda action: 2 * action
    )
    observation = {
        "agent_pos": np.array([1.0, 2.0, 3.0]),
        "environment_state": np.array([4.0, 5.0]),
        "agent_vel": np.array([6.0]),
        "pixels": {"top": np.full((5, 7, 3), 255, np.uint8)},
    }
    loaded.reset()
    action = loaded.act(observation, task="lift the cube")
    (batch,) = policy.batches
    assert policy.n_resets == 1
    assert action.tolist() == [4.0, 6.0]
    assert batch["task"] == ["lift the cube"]
    assert batch["observation.images.top"].shape == (1, 3, 5, 7)
    assert batch["observation.images.top"].max() == 1
    assert batch["observation.environment_state"].tolist() == [[4.0, 5.0]]
    assert batch["observation.agent_vel"].shape == (1, 1)


def test_a_policy_acts_without_an_instruction_when_none_is_given():
    policy = Recorder()
    loaded = ac.LoadedPolicy(policy, preprocessor=lambda batch: batch, postprocessor=lambda action: action)
    loaded.act({"agent_pos": np.zeros(3)})
    assert "task" not in policy.batches[0]
