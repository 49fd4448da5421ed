"""Train act_chunked with LeRobot's own training loop, from Python."""

import argparse
from pathlib import Path

from lerobot.configs.default import DatasetConfig
from lerobot.configs.train import TrainPipelineConfig
from lerobot.scripts.lerobot_train import train
from lerobot.utils.import_utils import register_third_party_plugins

from lerobot_act_chunking.policies.act_chunked.configuration_act_chunked import ActChunkedConfig


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--root", type=Path, default=Path("outputs/examples/dataset"))
    parser.add_argument("--out", type=Path, default=Path("outputs/examples/train"))
    parser.add_argument("--steps", type=int, default=4000)
    args = parser.parse_args()

    register_third_party_plugins()  # what LeRobot's commands do first; switches fast chunks on
    policy = ActChunkedConfig(
        device="cpu",
        push_to_hub=False,
        chunk_size=100,
        actions_per_query=5,
        dim_model=128,
        n_heads=4,
        n_encoder_layers=2,
        dropout=0.0,
        optimizer_lr=1e-3,
        lr_warmup_steps=200,
    )
    train(
        TrainPipelineConfig(
            dataset=DatasetConfig(repo_id="local/transfer_cube", root=str(args.root)),
            policy=policy,
            output_dir=args.out,
            steps=args.steps,
            save_freq=args.steps,
            batch_size=64,
            num_workers=0,
            env_eval_freq=0,
            seed=0,
        )
    )


if __name__ == "__main__":
    main()
