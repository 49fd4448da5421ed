"""PEFT adapters without ``--peft.target_modules``: the modules that each policy names by default."""

import re

import pytest
import torch
from policy_cases import CASES, ENVIRONMENT, STATE, TOP, WRAPPED, A, B, Case, history_batch
from torch import nn

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.heads.make import HEADS
from lerobot_act_chunking.nn.denoisers.make import DENOISERS
from lerobot_act_chunking.nn.latents.make import LATENTS
from lerobot_act_chunking.policies.temporal_ensemble.configuration_temporal_ensemble import (
    TemporalEnsembleConfig,
)
from lerobot_act_chunking.policies.temporal_ensemble.modeling_temporal_ensemble import TemporalEnsemblePolicy
from lerobot_act_chunking.tokenizers.coders import CODERS
from lerobot_act_chunking.tokenizers.make import TOKENIZERS

ADAPTABLE = (nn.Linear, nn.Embedding, nn.Conv1d, nn.Conv2d, nn.Conv3d, nn.MultiheadAttention)  # by PEFT
VAE = {"use_vae": True, "z_inference": "sample"}
VARIANTS = {
    "act_chunked": [
        *({"decoder_type": kind} for kind in ("parallel", "autoregressive")),
        {"decoder_type": "autoregressive", "action_likelihood": "gmm"},
        *({"action_likelihood": kind} for kind in HEADS),
        *({**VAE, "latent_type": kind} for kind in LATENTS),
        *({"image_tokens": kind} for kind in ("cells", "summary")),
        {"n_obs_steps": 2, "use_velocity": True},
        {"pre_norm": True},
        {"vision_backbone": "resnet18", "pretrained_backbone_weights": None},
    ],
    "diffusion_chunked": [
        *(
            {"denoiser": denoiser, "objective": objective}
            for denoiser in DENOISERS
            for objective in ("flow", "ddpm", "two_step")
        ),
        {"denoiser": "unet1d", "use_film_scale_modulation": False, "down_dims": (8, 16), "horizon": 6},
    ],
    "vqbet_chunked": [
        *({"tokenizer": kind} for kind in TOKENIZERS),
        *({"offset_mode": kind} for kind in ("code_conditioned", "table")),
        *({"vqvae_coder": kind} for kind in CODERS),
        {"sequentially_select": False},
    ],
}
ADAPTED = [
    *CASES,
    *(
        Case(str(settings), policy_type, STATE | ENVIRONMENT | TOP, settings)
        for policy_type, variants in VARIANTS.items()
        for settings in variants
    ),
]


def make(case, **overrides):
    return case.policy(use_ema=False, **overrides)


def wrapped(case):
    """The wrapper over the policy of a case."""
    config = case.config(use_ema=False)
    inner = make(case)
    policy = TemporalEnsemblePolicy(
        TemporalEnsembleConfig(
            inner=TemporalEnsembleConfig._encoded(config),
            input_features=dict(config.input_features),
            output_features=dict(config.output_features),
            device="cpu",
            push_to_hub=False,
            execution="open_loop",
        )
    )
    policy.inner.load_state_dict(inner.state_dict())
    return policy


def named_by(policy):
    """The modules that the default pattern names, and those that are trained whole, as PEFT finds them."""
    defaults = policy._get_default_peft_targets()
    modules = dict(policy.named_modules())
    adapted = {name for name in modules if re.fullmatch(defaults["target_modules"], name)}
    saved = [{name for name in modules if name.endswith(end)} for end in defaults["modules_to_save"]]
    return modules, adapted, saved


@pytest.mark.parametrize("case", ADAPTED, ids=lambda case: f"{case.type}-{case.name}")
def test_the_defaults_name_what_adapters_can_wrap_and_nothing_else(case):
    check_names(make(case))


@pytest.mark.parametrize("case", ADAPTED[::4], ids=lambda case: f"{case.type}-{case.name}")
def test_so_do_those_of_the_wrapper(case):
    check_names(wrapped(case))


def check_names(policy):
    modules, adapted, saved = named_by(policy)
    assert adapted
    assert {name for name in adapted if not isinstance(modules[name], ADAPTABLE)} == set()
    for names in saved:  # PEFT keeps these whole: nothing within them is adapted
        (whole,) = names
        assert not any(name.startswith(f"{whole}.") for name in adapted)


@pytest.mark.parametrize("make_policy", [make, wrapped])
@pytest.mark.parametrize("case", ADAPTED[::3], ids=lambda case: f"{case.type}-{case.name}")
def test_adapters_learn_and_are_in_effect(case, make_policy):
    pytest.importorskip("peft")
    policy = make_policy(case).eval()
    policy.config.pretrained_path = "somewhere"
    for parameter in policy.parameters():  # some layers are zero at first, and hide what is before them
        parameter.data += 0.1 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(2))
    batch = history_batch(policy)
    noise = {name: value for name, value in case.noise(B).items() if value.ndim > 1}
    before = policy.predict_action_chunk(batch, **noise)
    adapted = policy.wrap_with_peft(peft_cli_overrides={"r": 2})
    learning = {name: p for name, p in adapted.named_parameters() if p.requires_grad}
    assert all("lora_" in name or "modules_to_save" in name for name in learning)
    torch.testing.assert_close(adapted.predict_action_chunk(batch, **noise), before)
    loss, _ = adapted.train().forward(batch)
    loss.backward()
    assert any(p.grad is not None and p.grad.any() for name, p in learning.items() if "lora_" in name)
    for name, parameter in learning.items():
        if "lora_B" in name:  # zero at first, so that nothing changes
            parameter.data.fill_(0.3)
    assert (adapted.predict_action_chunk(batch, **noise) - before).abs().max() > 1e-4
    assert adapted.select_action(case.batch()).shape[1] == A


def test_averaged_weights_and_adapters_exclude_each_other_also_in_the_wrapper():
    policy = WRAPPED.policy()
    policy.config.pretrained_path = "somewhere"
    with pytest.raises(ConfigurationError, match="use_ema does not follow PEFT adapters"):
        policy._validate_peft_config(None)
