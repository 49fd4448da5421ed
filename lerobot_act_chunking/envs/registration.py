"""Gymnasium ids of the simulated environments."""

import gymnasium as gym

GYM_IDS = {
    "transfer_cube": "aloha_sim/TransferCube-v0",
    "insertion": "aloha_sim/Insertion-v0",
}
"""Gymnasium id of each ALOHA task."""


def register_gymnasium_ids() -> None:
    """Register every environment once; the classes are imported only when one is made."""
    for task, gym_id in GYM_IDS.items():
        if gym_id not in gym.registry:
            gym.register(
                gym_id,
                entry_point="lerobot_act_chunking.envs.aloha.env:AlohaSimEnv",
                max_episode_steps=400,
                kwargs={"task": task},
            )
