"""Demonstrated chunks as codes, with each of the four tokenizers: what do they cost, what is lost?"""

import argparse
from pathlib import Path

import numpy as np
import torch
from lerobot.configs import NormalizationMode

from lerobot_act_chunking.data.actions import read_demonstrations
from lerobot_act_chunking.data.timing import ChunkTiming
from lerobot_act_chunking.policies.vqbet_chunked.action_chunks import ActionChunks
from lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked import VqbetChunkedConfig
from lerobot_act_chunking.tokenizers.make import make_tokenizer
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec

TOKENIZERS = {
    "residual_vq": {"vqvae_num_layers": 4},
    "fsq": {"vqvae_num_layers": 4, "fsq_levels": (2, 2, 2, 2)},
    "uniform": {"n_bins": 65},
    "dct": {"n_bins": 65, "dct_coefficients": 5},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--root", type=Path, default=Path("outputs/examples/dataset"))
    parser.add_argument("--steps", type=int, default=1000)
    args = parser.parse_args()

    timing = ChunkTiming(n_obs_steps=1, chunk_size=20, chunk_stride=5)
    demonstrations = read_demonstrations(args.root)
    chunks = ActionChunks(demonstrations, timing, NormalizationMode.MIN_MAX, floor=1e-2)
    rng = np.random.default_rng(0)

    for name, settings in TOKENIZERS.items():
        torch.manual_seed(0)
        config = VqbetChunkedConfig(tokenizer=name, device="cpu", **settings)
        spec = TokenizerSpec.from_fields(config, timing.chunk_size, action_dim=len(chunks.names))
        tokenizer = make_tokenizer(spec)
        if tokenizer.is_learned:
            optimizer = torch.optim.AdamW(tokenizer.parameters(), lr=1e-3)
            for step in range(args.steps):
                learned = tokenizer.learn(*chunks.take(rng.integers(len(chunks), size=256)), seed=step)
                learned.loss.mean().backward()
                optimizer.step()
                optimizer.zero_grad()
        actions, is_pad = chunks.take(np.arange(len(chunks)))
        error = tokenizer.reconstruction_error(actions, is_pad).mean()
        bits = tokenizer.n_codes * np.log2(tokenizer.vocabulary)
        print(f"{name}: {tokenizer.n_codes} codes, {bits:.0f} bits, error {error:.4f} of half the range")


if __name__ == "__main__":
    main()
