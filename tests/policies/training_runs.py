"""A small dataset, and the arguments of LeRobot's training command for it."""

import numpy as np
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from policy_cases import MODULES, TYPES
from safetensors.torch import load_file


def record(root, spoiled=None, length=12):
    """Two episodes of ``length`` frames; the first frame of the feature ``spoiled`` holds a NaN."""
    names = {"observation.state": 6, "observation.environment_state": 7, "action": 4}
    features = {key: {"dtype": "float32", "shape": (n,), "names": None} for key, n in names.items()}
    dataset = LeRobotDataset.create("test/toy", fps=50, features=features, root=root, use_videos=False)
    generator = np.random.default_rng(0)
    for _ in range(2):
        for i in range(length):
            frame = {key: generator.normal(size=n).astype(np.float32) for key, n in names.items()}
            if spoiled is not None and i == 0:
                frame[spoiled][0] = np.nan
            dataset.add_frame({**frame, "task": "toy"})
        dataset.save_episode()
    dataset.finalize()
    return root


def fresh(dataset, output, *arguments, policy_type=TYPES[0]):
    run = f"--dataset.root={dataset} --output_dir={output} --dataset.repo_id=test/toy --batch_size=3"
    quiet = "--policy.device=cpu --policy.push_to_hub=false --num_workers=0 --log_freq=1 --save_freq=2"
    return [*f"--policy.type={policy_type} {run} {quiet} {MODULES[policy_type].TRAINED}".split(), *arguments]


def weights(run, step):
    return load_file(run / "checkpoints" / step / "pretrained_model" / "model.safetensors")
