"""Cases of `diffusion_chunked`."""

import torch
from policy_case import ENVIRONMENT, STATE, TOP, VELOCITY, WRIST, A, Case, Kind, T
from torch import Tensor

from lerobot_act_chunking.nn.denoisers.make import DENOISERS

DIFFUSION = {
    "horizon": T,
    "dim_model": 16,
    "n_layers": 2,
    "n_heads": 2,
    "down_dims": (8,),
    "n_groups": 4,
    "diffusion_step_embed_dim": 8,
    "spatial_softmax_num_keypoints": 3,
    "vision_backbone": "small_cnn",
}
DDPM = {"objective": "ddpm", "clip_sample_range": 4.0}  # the actions are not normalised
PAPER_AT_T = {"n_obs_steps": 1, "n_action_steps": T, "sampler": "ddim", "num_inference_steps": 20} | DDPM
GUIDED = {
    "guidance_features": ["observation.environment_state"],
    "condition_dropout": 0.5,
    "guidance_scale": 1.5,
}


def noise(case: Case, batch_size: int, generator: torch.Generator) -> dict[str, Tensor]:
    return {"noise": torch.randn(batch_size, T, A, generator=generator)}


KIND = Kind(
    DIFFUSION,
    {
        "dim_model": 48,
        "down_dims": (48,),
        "condition_dropout": 0.0,
        "guidance_scale": 1.0,
    },
    400,
    noise,
)
CASES = [
    Case("state", "diffusion_chunked", STATE, {"actions_per_token": 1}),
    Case("velocity", "diffusion_chunked", STATE | ENVIRONMENT, {"prediction_type": "velocity"}),
    Case("two-step", "diffusion_chunked", STATE | VELOCITY, {"objective": "two_step"}),
    Case("dit", "diffusion_chunked", ENVIRONMENT | TOP, {"denoiser": "dit", "use_ema": False}),
    Case("unet", "diffusion_chunked", STATE | TOP | WRIST, {"denoiser": "unet1d"} | DDPM),
    Case("paper", "diffusion_chunked", STATE | ENVIRONMENT, {"preset": "paper"} | PAPER_AT_T),
    Case("goal", "diffusion_chunked", STATE | ENVIRONMENT, {"denoiser": "dit"} | GUIDED),
    Case("prefix", "diffusion_chunked", STATE, {"actions_per_token": 1, "prefix_steps": 2}),
]
DETERMINISTIC = {"objective": "two_step"}
DRAWING = {"objective": "flow"}
SAMPLING = [
    *(case for case in CASES if case.name != "two-step"),  # it draws nothing
    Case("noise_hold", "diffusion_chunked", STATE, {"warm_start": "noise_hold"}),
]
OFTEN = {"replan_interval": 2}
KEPT = [  # what a policy can keep from step to step beside its plan
    Case(
        "frames", "diffusion_chunked", STATE | TOP, {"n_obs_steps": 3, "execution": "receding", "horizon": 7}
    ),
    Case("held noise", "diffusion_chunked", STATE, {"warm_start": "noise_hold"} | OFTEN),
    Case("edited", "diffusion_chunked", STATE, {"warm_start": "sdedit"} | OFTEN),
    Case("guided", "diffusion_chunked", STATE, {"warm_start": "rtc", "rtc_vjp": "exact"} | OFTEN),
    Case("coherent", "diffusion_chunked", STATE, {"execution": "coherence", "n_samples": 3}),
]
_NOISE = {"num_inference_steps": 2, "n_layers": 1}
_SAMPLERS = {
    **{name: {} for name in ("euler", "midpoint", "heun", "rk4")},
    **dict.fromkeys(("ddim", "ddpm", "dpm++"), DDPM),
}
EXPORTED = [  # the gate exports the first
    Case("history", "diffusion_chunked", STATE, {**_NOISE, "n_obs_steps": 2}),
    *(
        Case(
            name,
            "diffusion_chunked",
            STATE,
            {**_NOISE, **settings, "sampler": name, "num_inference_steps": 3},
        )
        for name, settings in _SAMPLERS.items()
    ),
    Case("two-step", "diffusion_chunked", STATE, {"objective": "two_step"}),
    Case("dit", "diffusion_chunked", STATE | TOP, {"denoiser": "dit"}),
    Case("unet", "diffusion_chunked", STATE | TOP, {"denoiser": "unet1d"}),
    Case("goal", "diffusion_chunked", STATE | ENVIRONMENT, {"denoiser": "dit"} | GUIDED),
    Case("held noise", "diffusion_chunked", STATE, {"warm_start": "noise_hold"} | {"replan_interval": 2}),
    Case(
        "coherent",
        "diffusion_chunked",
        STATE,
        {"execution": "coherence", "n_samples": 2, "replan_interval": 2},
    ),
]
LONG = [  # chunks longer than some episodes
    Case("diffusion", "diffusion_chunked", STATE, {"horizon": 12}),
    Case("past", "diffusion_chunked", STATE, {"align": "first_obs", "n_obs_steps": 2, "horizon": 12}),
]
_ADAPTED = (
    *(
        {"denoiser": denoiser, "objective": objective}
        for denoiser in DENOISERS
        for objective in ("flow", "ddpm", "two_step")
    ),
    {"denoiser": "unet1d", "use_film_scale_modulation": False, "down_dims": (8, 16), "horizon": 6},
)
ADAPTED = [Case(str(each), "diffusion_chunked", STATE | ENVIRONMENT | TOP, each) for each in _ADAPTED]
CHOICES = [("diffusion_chunked", "objective", "two_step")]  # of fields that LeRobot's policies have, too
TRAINED = "--policy.dim_model=16 --policy.n_layers=1 --policy.horizon=5"
SHORT = {"horizon": 4, "chunk_stride": 4, "dim_model": 16, "n_layers": 1}  # short chunks, to be evaluated
EVALUATED = [  # with these settings on the command line
    ("diffusion_chunked", "--policy.warm_start=rtc --policy.rtc_vjp=exact --policy.latency_steps=2"),
    ("diffusion_chunked", "--policy.warm_start=sdedit --policy.execution=receding"),
    ("diffusion_chunked", "--policy.warm_start=noise_hold"),
    ("diffusion_chunked", "--policy.execution=coherence --policy.sampler=heun"),
]

TINY = {  # for random configurations
    "horizon": 6,
    "dim_model": 8,
    "n_layers": 1,
    "n_heads": 2,
    "down_dims": (8,),
    "n_groups": 2,
    "diffusion_step_embed_dim": 8,
    "spatial_softmax_num_keypoints": 3,
}
INDIVISIBLE = [
    ("diffusion_chunked", {"horizon": 9, "actions_per_token": 20}, "horizon", "actions_per_token"),
    ("diffusion_chunked", {"dim_model": 12, "denoiser": "dit"}, "dim_model", "n_heads"),
]
TOO_COSTLY = [
    ("diffusion_chunked", {"dim_model": 2**14, "n_layers": 100}, "billion weights, more than 4"),
]

COHERENCE = {"execution": "coherence"}
PROVOKED = [  # errors whose text names the way out
    ("diffusion_chunked", {"n_action_steps": 1, "execution": "crossfade"}),
    ("diffusion_chunked", {"crossfade_steps": 3, "execution": "open_loop"}),
    ("diffusion_chunked", {"n_samples": 4}),
    ("diffusion_chunked", {"execution": "ensemble", "replan_interval": 100}),
    ("diffusion_chunked", {"prediction_dt": 0.001, "fps": 50.0}),
    ("diffusion_chunked", {"horizon_s": 0.001, "fps": 50.0}),
    ("diffusion_chunked", {"n_action_steps": 120}),
    ("diffusion_chunked", {"prediction_type": "epsilon"}),
    ("diffusion_chunked", {"denoiser": "unet1d", "prefix_steps": 3, "horizon": 64}),
    ("diffusion_chunked", {"align": "first_obs", "n_obs_steps": 2, "chunk_stride": 2, "horizon": 20}),
    ("diffusion_chunked", {"align": "first_obs", "n_obs_steps": 2, "warm_start": "rtc"}),
    ("diffusion_chunked", {"warm_start": "prefix"}),
    ("diffusion_chunked", {"guidance_scale": 2.0}),
    ("diffusion_chunked", {"condition_dropout": 0.1}),
    ("diffusion_chunked", {"warm_start": "noise_hold", **COHERENCE}),
    ("diffusion_chunked", {"objective": "two_step", **COHERENCE}),
    ("diffusion_chunked", {"objective": "two_step", "warm_start": "sdedit"}),
    ("diffusion_chunked", {"clip_mode": "lerobot"}),
    ("diffusion_chunked", {"timestep_spacing": "linspace"}),
    ("diffusion_chunked", {"objective": "ddpm", "sampler": "ddim", "num_inference_steps": 1}),
    ("diffusion_chunked", {"objective": "ddpm", "sampler": "dpm++", "num_inference_steps": 60}),
    ("diffusion_chunked", {"objective": "ddpm", "sampler": "dpm++", "timestep_spacing": "linspace"}),
]
