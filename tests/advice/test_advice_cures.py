"""Property: advice that names a setting is followed word by word, and cures."""

import re
from typing import Any, get_args, get_type_hints

import pytest
import yaml
from lerobot.configs import PreTrainedConfig

import lerobot_act_chunking.policies.act_chunked.configuration_act_chunked
import lerobot_act_chunking.policies.diffusion_chunked.configuration_diffusion_chunked
import lerobot_act_chunking.policies.vqbet_chunked.configuration_vqbet_chunked  # noqa: F401  (register)
from lerobot_act_chunking.errors import ConfigurationError

OPTION = r"(?:--policy\.)?([a-z_]+)=([\w.-]+\w|\w)"
Settings = dict[str, Any]

ACT, DIFFUSION, VQBET = "act_chunked", "diffusion_chunked", "vqbet_chunked"
COHERENCE = {"execution": "coherence"}
SAMPLED = {"use_vae": True, "z_inference": "sample"}
# What provokes an error whose text names the way out; the rest of the test is mechanical.
PROVOKED: list[tuple[str, Settings]] = [
    (ACT, {"n_action_steps": 1, "execution": "ensemble"}),
    (DIFFUSION, {"n_action_steps": 1, "execution": "crossfade"}),
    (VQBET, {"n_action_steps": 1, "execution": "receding"}),
    (ACT, {"temporal_ensemble_coeff": 0.1, "execution": "receding"}),
    (ACT, {"ensemble_weighting": "recency"}),
    (DIFFUSION, {"crossfade_steps": 3, "execution": "open_loop"}),
    (VQBET, {"adaptive_scale": 2.0}),
    (VQBET, {"adaptive_kernel": "gate"}),
    (DIFFUSION, {"n_samples": 4}),
    (ACT, {"temporal_ensemble_coeff": -0.1, "execution": "ensemble"}),
    (ACT, {"temporal_ensemble_coeff": 0.1, "ensemble_weighting": "uniform", "execution": "ensemble"}),
    (ACT, {"execution": "open_loop", "replan_interval": 20}),
    (VQBET, {"execution": "open_loop", "latency_steps": 3}),
    (DIFFUSION, {"execution": "ensemble", "replan_interval": 100}),
    (ACT, {"image_tokens": "summary", "n_obs_steps": 2}),
    (ACT, {"use_velocity": True}),
    (ACT, {"history_dropout": 0.1}),
    (ACT, {"execution": "ensemble", **SAMPLED, "z_hold": "chunk"}),
    (ACT, COHERENCE),
    (ACT, {**COHERENCE, **SAMPLED}),
    (ACT, {"action_temperature": 1.0}),
    (ACT, {"action_likelihood": "categorical", "action_top_k": 3}),
    (ACT, {"use_vae": True, "z_temperature": 0.0}),
    (ACT, {"use_vae": True, "z_hold": "steps"}),
    (ACT, {"use_vae": True, "z_hold_steps": 3}),
    (ACT, {"pretrained_backbone_weights": "ResNet18_Weights.IMAGENET1K_V1", "backbone_norm": "group"}),
    (ACT, {"vision_backbone": "small_cnn", "pretrained_backbone_weights": "imagenet"}),
    (ACT, {"horizon_s": 2.0, "fps": 50.0, "chunk_size": 30}),
    (VQBET, {"replan_s": 0.001, "fps": 50.0}),
    (DIFFUSION, {"prediction_dt": 0.001, "fps": 50.0}),
    (DIFFUSION, {"horizon_s": 0.001, "fps": 50.0}),
    (DIFFUSION, {"n_action_steps": 120}),
    (ACT, {"n_action_steps": 120}),
    (DIFFUSION, {"prediction_type": "epsilon"}),
    (DIFFUSION, {"denoiser": "unet1d", "prefix_steps": 3, "horizon": 64}),
    (DIFFUSION, {"align": "first_obs", "n_obs_steps": 2, "chunk_stride": 2, "horizon": 20}),
    (DIFFUSION, {"align": "first_obs", "n_obs_steps": 2, "warm_start": "rtc"}),
    (DIFFUSION, {"warm_start": "prefix"}),
    (DIFFUSION, {"guidance_scale": 2.0}),
    (DIFFUSION, {"condition_dropout": 0.1}),
    (DIFFUSION, {"warm_start": "noise_hold", **COHERENCE}),
    (DIFFUSION, {"objective": "two_step", **COHERENCE}),
    (DIFFUSION, {"objective": "two_step", "warm_start": "sdedit"}),
    (DIFFUSION, {"clip_mode": "lerobot"}),
    (DIFFUSION, {"timestep_spacing": "linspace"}),
    (DIFFUSION, {"objective": "ddpm", "sampler": "ddim", "num_inference_steps": 1}),
    (DIFFUSION, {"objective": "ddpm", "sampler": "dpm++", "num_inference_steps": 60}),
    (DIFFUSION, {"objective": "ddpm", "sampler": "dpm++", "timestep_spacing": "linspace"}),
    (VQBET, {"tokenizer": "dct", "tokenizer_training": "joint", "use_ema": False}),
    (VQBET, {"tokenizer_training": "joint"}),
    (VQBET, {"tokenizer": "uniform", "offset_mode": "table"}),
    (VQBET, {**COHERENCE, "bet_softmax_temperature": 0.0}),
    (VQBET, {**COHERENCE, "code_hold": "episode"}),
]
NAMES = [f"{kind}-{'-'.join(given)}-{place}" for place, (kind, given) in enumerate(PROVOKED)]


def make(policy_type: str, given: Settings) -> PreTrainedConfig:
    config_class = PreTrainedConfig.get_choice_class(policy_type)
    hints = get_type_hints(config_class)
    floats = {name for name in given if float in (hints[name], *get_args(hints[name]))}
    as_parsed = {name: float(given[name]) for name in floats if given[name] is not None}  # from "1", too
    return config_class(device="cpu", push_to_hub=False, **{**given, **as_parsed})


def advised(message: str) -> list[Settings]:
    """The settings that a message advises, one dictionary for each way out.

    Advice stands behind its last ": set". Ways out are parted by "or"; what belongs together is not.
    """
    _, _, advice = message.rpartition(": set ")
    parts = re.split(r",? or (?!more|less)", advice)
    found = [{name: yaml.safe_load(value) for name, value in re.findall(OPTION, part)} for part in parts]
    return [way for way in found if way]


@pytest.mark.parametrize(("policy_type", "given"), PROVOKED, ids=NAMES)
def test_every_way_out_leads_out(policy_type, given):
    with pytest.raises(ConfigurationError) as error:
        make(policy_type, given)
    message = str(error.value)
    ways = advised(message)
    assert ways, message
    for way in ways:
        make(policy_type, {**given, **way})
