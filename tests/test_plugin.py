"""What LeRobot and Gymnasium find when this package is installed."""

import importlib.metadata
import subprocess
import sys

import gymnasium as gym
from policy_cases import MODULES


def test_lerobot_discovers_the_installed_distribution_from_another_directory(tmp_path):
    code = f"""
from lerobot.configs import PreTrainedConfig
from lerobot.datasets import factory
from lerobot.envs.configs import EnvConfig
from lerobot.utils.import_utils import register_third_party_plugins

register_third_party_plugins()
print(sorted({set(MODULES)} & set(PreTrainedConfig.get_known_choices())))
print(sorted({{"aloha_sim", "so_arm_sim", "three_gates"}} & set(EnvConfig.get_known_choices())))
print(factory.LeRobotDataset.__name__)
"""
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", code],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines() == [
        str(sorted(MODULES)),
        "['aloha_sim', 'so_arm_sim', 'three_gates']",
        "FastChunkDataset",
    ]


def test_the_distribution_name_is_the_one_lerobot_looks_for():
    name = importlib.metadata.distribution("lerobot_policy_act_chunking").metadata["Name"]
    assert name == "lerobot_policy_act_chunking"


def test_importing_the_package_registers_environments_without_torch():
    code = (
        "import sys, gymnasium, lerobot_act_chunking;"
        "print(sorted(i for i in gymnasium.registry if i.startswith('aloha_sim/')), 'torch' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    ids = [
        f"aloha_sim/{task}-v0" for task in ("Insertion", "LanguageTransfer", "TransferCube", "TransferModes")
    ]
    assert done.stdout.strip() == f"{ids} False"


def test_environments_are_registered_here_too():
    assert {"aloha_sim/TransferCube-v0", "aloha_sim/Insertion-v0"} <= set(gym.registry)
