"""The tokenizers that are compared, in a few sizes each."""

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

from lerobot_act_chunking.policies.vqbet_chunked.presets import preset_values
from lerobot_act_chunking.tokenizers.spec import TokenizerSpec

# Sizes of each kind, from coarse to fine; a number of DCT coefficients is a share of the chunk.
_SIZES: tuple[dict[str, Any], ...] = (
    {"tokenizer": "residual_vq", "vqvae_num_layers": 2, "vqvae_n_embed": 16},
    {"tokenizer": "residual_vq", "vqvae_num_layers": 4, "vqvae_n_embed": 16},
    {"tokenizer": "residual_vq", "vqvae_num_layers": 4, "vqvae_n_embed": 64},
    {"tokenizer": "fsq", "vqvae_num_layers": 2, "fsq_levels": (2, 2, 2, 2)},
    {"tokenizer": "fsq", "vqvae_num_layers": 4, "fsq_levels": (2, 2, 2, 2)},
    {"tokenizer": "fsq", "vqvae_num_layers": 4, "fsq_levels": (3, 3, 3, 3)},
    {"tokenizer": "dct", "dct_coefficients": 0.1, "n_bins": 65},
    {"tokenizer": "dct", "dct_coefficients": 0.25, "n_bins": 65},
    {"tokenizer": "uniform", "n_bins": 16},
    {"tokenizer": "uniform", "n_bins": 256},
)


@dataclass(frozen=True)
class Candidate:
    """A tokenizer.

    Attributes:
        settings: those that matter for its kind, by the names of the policy's configuration.
    """

    settings: dict[str, Any] = field(default_factory=dict)

    @property
    def kind(self) -> str:
        """residual_vq, fsq, dct or uniform."""
        return self.settings["tokenizer"]

    @property
    def name(self) -> str:
        """For people."""
        settings = self.settings
        if self.kind == "residual_vq":
            return f"residual_vq {settings['vqvae_num_layers']} x {settings['vqvae_n_embed']}"
        if self.kind == "fsq":
            levels = ",".join(str(n) for n in settings["fsq_levels"])
            return f"fsq {settings['vqvae_num_layers']} x ({levels})"
        if self.kind == "dct":
            return f"dct {settings['dct_coefficients']}, {settings['n_bins']} bins"
        return f"uniform {settings['n_bins']} bins"

    @property
    def flags(self) -> str:
        """The options of ``lerobot-train`` that select it."""
        values = {name: list(v) if isinstance(v, tuple) else v for name, v in self.settings.items()}
        return " ".join(f"--policy.{name}={value}".replace(", ", ",") for name, value in values.items())

    def spec(self, chunk_size: int, action_dim: int) -> TokenizerSpec:
        """What it is built from; the other settings are those of preset ``base``."""
        values = preset_values("base", tokenizer=self.kind, pretrained=False) | self.settings
        return TokenizerSpec.from_fields(SimpleNamespace(**values), chunk_size, action_dim)


def candidates_for(chunk_size: int) -> list[Candidate]:
    """All candidates, with DCT coefficients in proportion to the chunk; none twice."""
    found: dict[str, Candidate] = {}
    for settings in _SIZES:
        if settings["tokenizer"] == "dct":
            count = max(1, round(settings["dct_coefficients"] * chunk_size))
            settings = {**settings, "dct_coefficients": count}
        candidate = Candidate(settings)
        found[candidate.name] = candidate
    return list(found.values())
