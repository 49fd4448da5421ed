import subprocess
import sys

import gymnasium as gym
import pytest

from lerobot_act_chunking.envs.registration import GYM_IDS, register_gymnasium_ids


@pytest.mark.parametrize(("task", "gym_id"), GYM_IDS.items())
def test_each_id_makes_its_task(task, gym_id):
    env = gym.make(gym_id)
    assert env.unwrapped.task == task
    env.close()


def test_registering_twice_changes_nothing():
    before = {gym_id: gym.registry[gym_id] for gym_id in GYM_IDS.values()}
    register_gymnasium_ids()
    assert all(gym.registry[gym_id] is spec for gym_id, spec in before.items())


def test_importing_the_package_registers_and_stays_cheap():
    program = """
import sys
import lerobot_act_chunking, gymnasium
assert {"aloha_sim/TransferCube-v0", "aloha_sim/Insertion-v0"} <= set(gymnasium.registry)
assert not {"torch", "lerobot", "mujoco"} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)
