"""A dataset of three episodes, and tokenizers that learn from it in no time."""

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset

from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_file import TokenizerTraining
from lerobot_act_chunking.policies.vqbet_chunked.tokenizer_training import plan_training

LENGTHS = (9, 14, 11)
NAMES = ["reach", "still", "gripper"]
FIELDS = {
    "chunk_size": 4,
    "chunk_stride": 2,
    "vqvae_n_embed": 3,
    "vqvae_embedding_dim": 5,
    "vqvae_enc_hidden_dim": 8,
}


def write_dataset(folder, scale=1.0):
    """Waves of different phases; the second dimension stands still."""
    features = {
        "action": {"dtype": "float32", "shape": (3,), "names": NAMES},
        "observation.state": {"dtype": "float32", "shape": (2,), "names": None},
    }
    dataset = LeRobotDataset.create("me/waves", fps=20, features=features, root=folder)
    for episode, length in enumerate(LENGTHS):
        for step in range(length):
            action = scale * np.array([np.sin(0.3 * step + episode), 0.5, step > 6], np.float32)
            state = np.zeros(2, np.float32)
            dataset.add_frame({"action": action, "observation.state": state, "task": "wave"})
        dataset.save_episode()
    dataset.finalize()
    return folder


def plan(folder, steps=6, preset="base", **fields):
    return plan_training(folder, preset, FIELDS | fields, TokenizerTraining(steps=steps, batch_size=10))
