"""Time per control step, chunk and training step of `vqbet_chunked`, beside LeRobot's vqbet and diffusion.

Both policies of a case get the same observations and take turns, so that whatever else the machine does hits
both alike. Printed are medians and the median of the paired ratios (below 1: ours is faster). Against
LeRobot: its default network on both sides, with one camera of 96 x 96 pixels, not cropped. Every fifth
control step needs a chunk: ``chunk is due`` is that step, ``control step`` the mean over all, and ``window``
a chunk whose five images are all new. Against `diffusion_chunked` (10 steps): chunks of 50 actions from
states alone, by networks of the same width, each with its default number of layers.

    python benchmarks/vqbet_latency.py [--repeats 5] [--threads 2] [--device cpu] [--output file.json]
"""

import argparse
import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch
from diffusion_latency import training_step
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.policies.vqbet.configuration_vqbet import VQBeTConfig
from lerobot.policies.vqbet.modeling_vqbet import VQBeTPolicy
from paired_timing import compare, medians, milliseconds

from lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked import (
    DiffusionChunkedConfig,
)
from lerobot_act_chunking.policies.diffusion_chunked.modeling_diffusion_chunked import DiffusionChunkedPolicy
from lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked import VqbetChunkedConfig
from lerobot_act_chunking.policies.vqbet_chunked.modeling_vqbet_chunked import VqbetChunkedPolicy

STATE = {"observation.state": PolicyFeature(FeatureType.STATE, (14,))}
OBJECTS = {"observation.environment_state": PolicyFeature(FeatureType.ENV, (7,))}
CAMERA = {"observation.images.top": PolicyFeature(FeatureType.VISUAL, (3, 96, 96))}
ACTION = {"action": PolicyFeature(FeatureType.ACTION, (14,))}
CHUNK = 50  # actions of a chunk, against diffusion
TRAINING_BATCH = 8
MANY = 50  # environments


@dataclass(frozen=True)
class Result:
    """Medians in milliseconds, and the median of paired ratios ours / other."""

    other: str
    quantity: str
    batch_size: int
    other_parameters: int
    our_parameters: int
    other_ms: float
    ours_ms: float
    ratio: float


class Pair:
    """Another policy and `vqbet_chunked`, of the same inputs."""

    def __init__(self, name: str, other: PreTrainedPolicy, ours: VqbetChunkedPolicy):
        ours.tokenizer_phase.n_learned.fill_(ours.tokenizer_phase.n_steps)
        self.name, self.other, self.ours = name, other.eval(), ours.eval()

    def result(self, quantity: str, batch_size: int, times: tuple[float, float, float]) -> Result:
        """``times``: medians of both, and the median ratio."""
        policies = self.other, self.ours
        parameters = [sum(p.numel() for p in policy.parameters() if p.requires_grad) for policy in policies]
        return Result(self.name, quantity, batch_size, *parameters, *times)


def features(inputs: dict[str, PolicyFeature], device: str) -> dict[str, Any]:
    """What every policy is built with."""
    return {"input_features": inputs, "output_features": ACTION, "device": device, "push_to_hub": False}


def beside_lerobot(device: str) -> Pair:
    """LeRobot's defaults, and the preset that is the same network."""
    common = {**features(STATE | CAMERA, device), "pretrained_backbone_weights": None}
    theirs = VQBeTPolicy(VQBeTConfig(**common, crop_shape=None)).to(device)
    theirs.vqbet.action_head.vqvae_model.discretized.fill_(True)
    theirs.vqbet.action_head.vqvae_model.vq_layer.freeze_codebook.fill_(True)
    return Pair(
        "LeRobot vqbet", theirs, VqbetChunkedPolicy(VqbetChunkedConfig(preset="paper", **common)).to(device)
    )


def beside_diffusion(denoiser: str, width: int, device: str) -> Pair:
    """Networks of one width; chunks of one length."""
    common = features(STATE | OBJECTS, device)
    other = DiffusionChunkedConfig(
        **common, denoiser=denoiser, dim_model=width, horizon=CHUNK, num_inference_steps=10
    )
    ours = VqbetChunkedConfig(**common, chunk_size=CHUNK, gpt_hidden_dim=width, gpt_n_head=4)
    return Pair(
        f"{denoiser} d{width}",
        DiffusionChunkedPolicy(other).to(device),
        VqbetChunkedPolicy(ours).to(device),
    )


def observations(inputs: dict[str, PolicyFeature], *leading: int, device: str) -> dict[str, torch.Tensor]:
    """Random normalised observations (*leading, ...)."""
    generator = torch.Generator().manual_seed(0)
    return {
        key: torch.rand(*leading, *feature.shape, generator=generator).to(device)
        for key, feature in inputs.items()
    }


def control_steps(pair: Pair, n_chunks: int, device: str) -> list[Result]:
    """Both policies act in turns; the first chunk is not counted."""
    observation, chunk_size = observations(STATE | CAMERA, 1, device=device), pair.ours.config.chunk_size
    rows = []
    for _ in range((n_chunks + 1) * chunk_size):
        calls = [
            lambda policy=policy: policy.select_action(dict(observation))
            for policy in (pair.other, pair.ours)
        ]
        rows.append([milliseconds(call) for call in calls])
    steps = torch.tensor(rows[chunk_size:]).unflatten(0, (n_chunks, chunk_size))  # (chunk, step, policy)
    columns = {"chunk is due": steps[:, 0], "control step": steps.mean(1)}
    return [pair.result(name, 1, medians(times.tolist())) for name, times in columns.items()]


def window(pair: Pair, repeats: int, device: str) -> Result:
    """A chunk from a window of new images: nothing is known of them beforehand."""
    seen = observations(STATE | CAMERA, 1, pair.ours.config.n_obs_steps, device=device)
    (key,) = CAMERA
    theirs = {"observation.images": seen[key][:, :, None], "observation.state": seen["observation.state"]}
    model: Any = pair.other.vqbet

    @torch.no_grad()
    def other() -> None:
        model(theirs, rollout=True)

    def ours() -> None:
        pair.ours.predict_action_chunk(seen)

    return pair.result("window", 1, compare(other, ours, repeats))


def time_training_step(pair: Pair, repeats: int, device: str) -> Result:
    """A training step behind the tokenizer's phase."""
    config = pair.ours.config
    batch = observations(STATE | CAMERA, TRAINING_BATCH, config.n_obs_steps, device=device)
    n_actions = len(config.action_delta_indices)
    batch |= observations({"action": ACTION["action"]}, TRAINING_BATCH, n_actions, device=device)
    batch["action_is_pad"] = torch.zeros(TRAINING_BATCH, n_actions, dtype=torch.bool, device=device)
    steps = [training_step(policy, batch) for policy in (pair.other, pair.ours)]
    return pair.result("training step", TRAINING_BATCH, compare(*steps, repeats))


def chunks(pair: Pair, batch_size: int, repeats: int, device: str) -> Result:
    """Chunks from states, for as many environments at once."""
    seen = observations(STATE | OBJECTS, batch_size, device=device)
    latest = {key: value[:, None] for key, value in seen.items()}
    calls = [lambda policy=policy: policy.predict_action_chunk(latest) for policy in (pair.other, pair.ours)]
    return pair.result("chunk" if batch_size == 1 else "chunks", batch_size, compare(*calls, repeats))


def line(result: Result) -> str:
    """A row of the table."""
    return (
        f"{result.other:16}{result.quantity:15}{result.batch_size:>6}"
        f"{result.other_parameters / 1e6:>9.2f}{result.our_parameters / 1e6:>9.2f}"
        f"{result.other_ms:>12.2f}{result.ours_ms:>12.2f}{result.ratio:>9.4f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description="Compare vqbet_chunked with vqbet and diffusion_chunked.")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--threads", type=int, default=torch.get_num_threads())
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--output", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(options.threads)
    torch.manual_seed(0)
    repeats, device = options.repeats, options.device
    print("other           quantity        batch  M other   M ours    other ms     ours ms    ratio")
    results: list[Result] = []

    def show(*new: Result) -> None:
        results.extend(new)
        print(*map(line, new), sep="\n", flush=True)

    lerobot = beside_lerobot(device)
    show(*control_steps(lerobot, 2 * repeats, device))
    show(window(lerobot, 2 * repeats, device))
    show(time_training_step(lerobot, repeats, device))
    for denoiser in ("mixer", "dit"):
        diffusion = beside_diffusion(denoiser, 128, device)
        for batch_size in (1, MANY):
            show(chunks(diffusion, batch_size, 4 * repeats, device))
    if options.output:
        settings = {"device": device, "threads": options.threads, "repeats": repeats}
        rows = [asdict(result) for result in results]
        options.output.write_text(json.dumps({**settings, "results": rows}, indent=2) + "\n")


if __name__ == "__main__":
    main()
