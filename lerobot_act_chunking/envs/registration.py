"""Gymnasium ids of the simulated environments."""

import gymnasium as gym

from lerobot_act_chunking.envs.robotics.tasks import TASKS as ROBOTICS_TASKS

GYM_IDS = {
    "transfer_cube": "aloha_sim/TransferCube-v0",
    "insertion": "aloha_sim/Insertion-v0",
    "transfer_modes": "aloha_sim/TransferModes-v0",
    "language_transfer": "aloha_sim/LanguageTransfer-v0",
}
"""Gymnasium id of each ALOHA task."""
SO_ARM_IDS = {
    "pick_place": "so_arm_sim/PickPlace-v0",
    "stack": "so_arm_sim/Stack-v0",
    "two_ways": "so_arm_sim/TwoWays-v0",
}
"""Gymnasium id of each task of the SO-101."""
THREE_GATES_ID = "three_gates/ThreeGates-v0"


def robotics_id(task: str) -> str:
    """Gymnasium id of a gymnasium-robotics task in LeRobot's shape; the original's has no prefix."""
    return f"gymnasium_robotics/{task}"


def register_gymnasium_ids() -> None:
    """Register every environment once; the classes are imported only when one is made."""
    for task, gym_id in GYM_IDS.items():
        _register(gym_id, "lerobot_act_chunking.envs.aloha.env:AlohaSimEnv", task, max_episode_steps=400)
    for task, gym_id in SO_ARM_IDS.items():
        _register(gym_id, "lerobot_act_chunking.envs.so_arm.env:SoArmEnv", task, max_episode_steps=400)
    gates = "lerobot_act_chunking.envs.three_gates.env:ThreeGatesEnv"
    _register(THREE_GATES_ID, gates, "three_gates", max_episode_steps=40)
    for task in ROBOTICS_TASKS:
        # Without a limit: to tell the final success, the environment keeps the time itself.
        _register(robotics_id(task), "lerobot_act_chunking.envs.robotics.env:RoboticsEnv", task)


def _register(gym_id: str, entry_point: str, task: str, max_episode_steps: int | None = None) -> None:
    if gym_id not in gym.registry:
        gym.register(
            gym_id, entry_point=entry_point, max_episode_steps=max_episode_steps, kwargs={"task": task}
        )
