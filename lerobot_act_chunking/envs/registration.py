"""Gymnasium ids of the simulated environments."""

import gymnasium as gym

ENTRY_POINTS = {
    "aloha_sim/TransferCube-v0": "transfer_cube",
    "aloha_sim/Insertion-v0": "insertion",
}


def register_gymnasium_ids() -> None:
    """Register every environment once; the classes are imported only when one is made."""
    for gym_id, task in ENTRY_POINTS.items():
        if gym_id not in gym.registry:
            gym.register(
                gym_id,
                entry_point="lerobot_act_chunking.envs.aloha.env:AlohaSimEnv",
                max_episode_steps=400,
                kwargs={"task": task},
            )
