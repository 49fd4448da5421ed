"""What the tests of all denoisers share."""

from dataclasses import replace

import torch
from torch import Tensor, nn

from lerobot_act_chunking.nn.condition import Condition
from lerobot_act_chunking.nn.denoisers.denoiser import Denoiser
from lerobot_act_chunking.nn.denoisers.dit import Dit
from lerobot_act_chunking.nn.denoisers.make import DENOISERS, make_denoiser
from lerobot_act_chunking.nn.denoisers.mixer import Mixer
from lerobot_act_chunking.nn.denoisers.spec import DenoiserInputs, DenoiserSpec
from lerobot_act_chunking.nn.denoisers.time import UnitTimeEmbedding
from lerobot_act_chunking.nn.denoisers.unet1d import Unet1d

B, T, A, G, N, D, PATCH = 3, 20, 4, 13, 7, 16, 5


def mixer(**changes) -> Mixer:
    settings = {
        "action_dim": A,
        "horizon": T,
        "condition_dim": G,
        "dim": D,
        "n_layers": 2,
        "dropout": 0.0,
        "time_embedding": UnitTimeEmbedding(D),
        "patch_size": PATCH,
    }
    return Mixer(**settings | changes)


def dit(**changes) -> Dit:
    settings = {
        "action_dim": A,
        "horizon": T,
        "dim": D,
        "n_layers": 2,
        "n_heads": 2,
        "dropout": 0.0,
        "time_embedding": UnitTimeEmbedding(D),
        "patch_size": PATCH,
    }
    return Dit(**settings | changes)


def unet1d(**changes) -> Unet1d:
    settings = {
        "action_dim": A,
        "condition_dim": G,
        "time_embedding": UnitTimeEmbedding(D),
        "time_dim": D,
        "down_dims": (16, 24, 32),
        "kernel_size": 5,
        "n_groups": 8,
        "film_scale": True,
    }
    return Unet1d(**settings | changes)


SPEC = DenoiserSpec(
    denoiser="mixer",
    horizon=T,
    actions_per_token=PATCH,
    dim_model=D,
    n_layers=2,
    n_heads=2,
    dropout=0.0,
    down_dims=(16, 24, 32),
    kernel_size=5,
    n_groups=8,
    diffusion_step_embed_dim=D,
    use_film_scale_modulation=True,
)


def small(name: str) -> Denoiser:
    width = D if DENOISERS[name].reads_tokens else G
    return make_denoiser(replace(SPEC, denoiser=name), DenoiserInputs(A, width, UnitTimeEmbedding))


def shaken[ModuleT: nn.Module](module: ModuleT) -> ModuleT:
    """The module with every parameter moved off its special initial value."""
    generator = torch.Generator().manual_seed(1)
    for parameter in module.parameters():
        parameter.data += 0.2 * torch.randn(parameter.shape, generator=generator)
    return module


def draw(*shape: int, seed: int = 2) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def condition(batch_size: int = B, seed: int = 3) -> Condition:
    """What any of them can read."""
    return Condition(vector=draw(batch_size, G, seed=seed), tokens=draw(batch_size, N, D, seed=seed))


def answer(denoiser: Denoiser, x: Tensor, time: Tensor, observed: Condition) -> Tensor:
    return denoiser(x, denoiser.modulate(time), denoiser.observe(observed))
