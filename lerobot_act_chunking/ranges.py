"""What every field of every configuration may hold; the one place where ranges are declared."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from lerobot_act_chunking.errors import ConfigurationError


@dataclass(frozen=True)
class Range:
    """Finite numbers between two limits.

    Attributes:
        least: the smallest number allowed, or the one to lie above.
        most: the largest number allowed, or the one to lie below.
        above: whether ``least`` itself is refused.
        below: whether ``most`` itself is refused.
        hint: what to do instead, for the message.
    """

    least: float
    most: float
    above: bool = False
    below: bool = False
    hint: str = ""

    def __contains__(self, value: float) -> bool:
        """Whether the number is allowed; NaN never is."""
        low = self.least < value if self.above else self.least <= value
        return low and (value < self.most if self.below else value <= self.most)

    def __str__(self) -> str:
        low = f"{'above' if self.above else 'at least'} {_plain(self.least)}"
        hint = f": {self.hint}" if self.hint else ""
        return f"{low} and {'below' if self.below else 'at most'} {_plain(self.most)}{hint}"


def _plain(number: float) -> str:
    return f"{number:.15g}" if math.isfinite(number) else str(number)


# Upper limits lie beyond anything useful, and well before memory, time or single precision give out. What
# several fields cost together is checked where they meet: `ChunkTiming` and `ChunkedPolicy`.
_STEPS_OF_TRAINING = 10**9
_FRACTION = Range(0, 1, below=True)
_POSITIVE_FRACTION = Range(0, 1, above=True)
_WEIGHT = Range(0, 10**6)  # of a loss
_WIDTH = Range(1, 2**14)  # of a layer; LeRobot's widest policies have 2**11
_LAYERS = Range(1, 100)
_HEADS = Range(1, 2**8)
_SEED = Range(0, 2**63 - 1)  # what torch.Generator takes
# AdamW moves every weight by about the rate in each step.
_RATE = Range(0, 1)
_TEMPERATURE = Range(0, 100)
_SECONDS = Range(0, 10**5)
_PREDICTIONS = Range(1, 10**4)  # three minutes at 50 Hz; each of them is a query or part of a token

RANGES: dict[str, Range] = {
    # Time.
    "fps": Range(0, 10**5, above=True),
    "horizon_s": _SECONDS,
    "prediction_dt": _SECONDS,
    "replan_s": _SECONDS,
    "n_obs_steps": Range(1, 1000),  # each sample brings so many images of every camera
    "obs_stride": Range(1, 1000),
    "chunk_size": _PREDICTIONS,
    "horizon": _PREDICTIONS,
    "chunk_stride": Range(1, 10**4),
    "n_action_pred_token": Range(1, 1000),
    # Execution; `ExecutionSettings` knows what goes together.
    "n_action_steps": Range(1, 10**5),
    "replan_interval": Range(1, 10**5),
    "latency_steps": Range(0, 10**5),
    "temporal_ensemble_coeff": Range(
        0,
        100,
        hint="set ensemble_weighting=recency and temporal_ensemble_coeff=0.01 to favour new predictions, for "
        "which LeRobot takes a negative one",
    ),
    "crossfade_steps": Range(1, 10**5),
    "smoothing_steps": Range(1, 10**5),
    "adaptive_scale": Range(0, 10**6, above=True),
    "n_samples": Range(2, 1000),
    "gripper_dims": Range(0, 10**5),
    "limit_margin": Range(0, 10),
    "max_speed": Range(0, 1000, above=True, hint="1 is as fast as demonstrated"),
    # Data and optimiser.
    "norm_std_floor": Range(0, 10**6),
    "ema_power": Range(0, 100),
    "ema_max_value": _FRACTION,
    "optimizer_lr": _RATE,
    "optimizer_lr_backbone": _RATE,
    "optimizer_lr_encoder": _RATE,
    "optimizer_vqvae_lr": _RATE,
    "optimizer_weight_decay": Range(0, 100),
    "optimizer_vqvae_weight_decay": Range(0, 100),
    "optimizer_betas": _FRACTION,
    "lr_warmup_steps": Range(0, _STEPS_OF_TRAINING),
    "noise_seed": _SEED,
    # Networks.
    "dim_model": _WIDTH,
    "dim_feedforward": Range(1, 2**16),
    "n_heads": _HEADS,
    "n_layers": _LAYERS,
    "n_encoder_layers": _LAYERS,
    "n_decoder_layers": _LAYERS,
    "n_vae_encoder_layers": _LAYERS,
    "encoder_vocabulary": Range(0, 10**6),
    "encoder_text_tokens": Range(1, 10**4),
    "dropout": _FRACTION,
    "gpt_hidden_dim": _WIDTH,
    "gpt_n_layer": _LAYERS,
    "gpt_n_head": _HEADS,
    "head_hidden_dims": _WIDTH,
    "down_dims": _WIDTH,
    "kernel_size": Range(1, 99),
    "n_groups": Range(1, 2**14),
    "diffusion_step_embed_dim": Range(4, 2**14),  # its sine and cosine need two frequencies each
    "actions_per_query": _PREDICTIONS,
    "actions_per_token": _PREDICTIONS,
    "spatial_softmax_num_keypoints": Range(1, 2**12),
    "history_image_grid": Range(1, 64),
    "random_shift": Range(0, 10**4),
    "resize_shape": Range(1, 10**4),
    "crop_shape": Range(1, 10**4),
    # act_chunked.
    "history_dropout": _FRACTION,
    "teacher_dropout": _FRACTION,
    "teacher_noise_std": Range(0, 100),
    "nll_beta": Range(0, 1),
    "min_std": Range(
        0, 1, above=True, below=True, hint="normalised actions have a standard deviation of about 1"
    ),
    "n_components": Range(1, 1000),
    "n_bins": Range(2, 2**16),
    "hl_gauss_sigma": Range(0, 1000),
    "soft_local_bins": Range(0, 2**16),
    "action_temperature": _TEMPERATURE,
    "action_top_k": Range(0, 2**16),
    "latent_dim": _WIDTH,
    "n_latent_components": Range(2, 10**4),
    "latent_warmup_steps": Range(1, _STEPS_OF_TRAINING),
    "z_temperature": Range(
        0, 100, above=True, hint="set z_temperature=1 (z_inference=mode takes the likeliest style)"
    ),
    "z_hold_steps": Range(0, _STEPS_OF_TRAINING),
    "vae_action_stride": _PREDICTIONS,
    "kl_weight": _WEIGHT,
    "kl_anneal_steps": Range(1, _STEPS_OF_TRAINING),
    "free_bits": _WEIGHT,
    # diffusion_chunked.
    "num_train_timesteps": Range(1, 10**4),
    "num_inference_steps": Range(1, 10**4),  # each calls the network, for every chunk
    "beta_start": Range(0, 1, above=True, below=True),
    "beta_end": Range(0, 1, above=True, below=True),
    "clip_sample_range": Range(0, 10**6, above=True),
    "prefix_steps": Range(0, 10**5),
    "max_guidance_weight": Range(0, 10**6, above=True),
    "sdedit_strength": _POSITIVE_FRACTION,
    "condition_dropout": _FRACTION,
    "guidance_scale": Range(-1000, 1000),
    # vqbet_chunked.
    "n_vqvae_training_steps": Range(1, _STEPS_OF_TRAINING),
    "vqvae_n_embed": Range(2, 2**16),
    "vqvae_num_layers": _LAYERS,
    "vqvae_embedding_dim": _WIDTH,
    "vqvae_enc_hidden_dim": _WIDTH,
    "vqvae_decay": Range(
        0, 1, below=True, hint="the share that the codebook's moving average keeps in each step"
    ),
    "commitment_weight": _WEIGHT,
    "kmeans_iters": Range(0, 1000),
    "dead_code_threshold": Range(0, 100),
    "fsq_levels": Range(2, 2**16),
    "dct_coefficients": _PREDICTIONS,
    "focal_gamma": Range(0, 100),
    "primary_code_loss_weight": _WEIGHT,
    "secondary_code_loss_weight": _WEIGHT,
    "offset_loss_weight": _WEIGHT,
    "bet_softmax_temperature": _TEMPERATURE,
    "top_p": _POSITIVE_FRACTION,
    "mode_balance_power": Range(0, 1),
    # Instructions.
    "language_tokens": Range(3, 4096, hint="two of them mark the beginning and the end"),
    "language_dropout": _FRACTION,
}
"""For every field of numbers, or of lists of numbers, those that it may hold; all types share it."""


def check_ranges(source: object, *names: str) -> None:
    """Refuse numbers that these attributes of ``source`` may not hold, by their `RANGES`.

    Raises:
        ConfigurationError: naming the attribute, its value and what is allowed.
    """
    for name in names:
        value = getattr(source, name)
        if not all(number in RANGES[name] for number in _numbers(value)):
            raise ConfigurationError(f"{name}={value} must be {RANGES[name]}")


def _numbers(value: Any) -> Iterator[float]:
    """The numbers in a field of one, or of a list of them."""
    if isinstance(value, list | tuple):
        yield from value
    else:
        yield value
