"""The declared map from the parameters of LeRobot's ``act`` to those of `act_chunked`.

Every entry of LeRobot's state dict is consumed exactly once, mapped or dropped for a reason; what is left
over or missing is an error.
"""

from collections.abc import Mapping

import torch
import torch.nn.functional as F  # noqa: N812
from lerobot.policies.act.configuration_act import ACTConfig
from torch import Tensor

from lerobot_act_chunking.errors import ConfigurationError

OBSERVATION = "model.observation_encoder"
STYLE = "model.style_encoder"


class WeightMap:
    """Moves entries from LeRobot's state dict to ours, module by module; `convert` does them all.

    Args:
        theirs: state dict of LeRobot's ``ACTPolicy``.
        config: its settings.

    Attributes:
        ours: entries of our state dict so far.
        without_effect: LeRobot's entries on which no output depends.
    """

    def __init__(self, theirs: Mapping[str, Tensor], config: ACTConfig):
        self.theirs = {key.removeprefix("model."): value for key, value in theirs.items()}
        self.config = config
        self.ours: dict[str, Tensor] = {}
        self.without_effect: dict[str, Tensor] = {}

    def convert(self) -> dict[str, Tensor]:
        """Our whole state dict.

        Raises:
            ConfigurationError: naming entries that the settings promise but that are missing, or entries that
                no setting explains.
        """
        self._style()
        self._observations()
        self._encoder("encoder", "model.encoder", self.config.n_encoder_layers)
        self._decoder()
        self._module("action_head", "model.head.projection")
        if self.theirs:
            raise ConfigurationError(f"LeRobot's act has no weights called {', '.join(sorted(self.theirs))}")
        return self.ours

    def take(self, key: str) -> Tensor:
        """An entry of LeRobot's, which is then done with."""
        if key not in self.theirs:
            raise ConfigurationError(f"the weights lack model.{key}, which the settings ask for")
        return self.theirs.pop(key)

    def start(self, layer: str) -> Tensor:
        """Our decoder's first vector: LeRobot's first self-attention, which acts on zeros, in closed form."""
        in_proj, shift = self.take_self_attention(layer)
        weight, bias, scale, offset = (
            self.take(f"{layer}.{name}")
            for name in ("self_attn.out_proj.weight", "self_attn.out_proj.bias", "norm1.weight", "norm1.bias")
        )
        dtype, pre_norm = weight.dtype, self.config.pre_norm
        in_proj, shift, weight, bias, scale, offset = (
            each.double() for each in (in_proj, shift, weight, bias, scale, offset)
        )
        value = shift + (in_proj @ offset if pre_norm else 0)
        constant = weight @ value + bias
        start = constant if pre_norm else F.layer_norm(constant, scale.shape, scale, offset)
        return start.to(dtype)

    def take_self_attention(self, layer: str) -> tuple[Tensor, Tensor]:
        """Weight (D, D) and bias (D,) of the values; between equal vectors, queries and keys do not count."""
        weight = self.take(f"{layer}.self_attn.in_proj_weight")
        bias = self.take(f"{layer}.self_attn.in_proj_bias")
        dim = self.config.dim_model
        self.without_effect[f"{layer}.self_attn.in_proj_weight[queries, keys]"] = weight[: 2 * dim]
        return weight[2 * dim :], bias[2 * dim :]

    def _module(self, theirs: str, ours: str, names: tuple[str, ...] = ("weight", "bias")) -> None:
        for name in names:
            self.ours[f"{ours}.{name}"] = self.take(f"{theirs}.{name}")

    def _attention(self, theirs: str, ours: str) -> None:
        q, k, v = self.take(f"{theirs}.in_proj_weight").chunk(3)
        q_bias, k_bias, v_bias = self.take(f"{theirs}.in_proj_bias").chunk(3)
        self.without_effect[f"{theirs}.in_proj_bias[keys]"] = k_bias  # cancelled by the softmax
        self.ours |= {f"{ours}.q_proj.weight": q, f"{ours}.k_proj.weight": k, f"{ours}.v_proj.weight": v}
        self.ours |= {f"{ours}.q_proj.bias": q_bias, f"{ours}.v_proj.bias": v_bias}
        self._module(f"{theirs}.out_proj", f"{ours}.out_proj")

    def _feed_forward(self, theirs: str, ours: str, norm: str) -> None:
        self._module(f"{theirs}.linear1", f"{ours}.expand")
        self._module(f"{theirs}.linear2", f"{ours}.contract")
        self._module(f"{theirs}.{norm}", f"{ours}.norm")

    def _encoder(self, theirs: str, ours: str, n_layers: int) -> None:
        for i in range(n_layers):
            their_layer, our_layer = f"{theirs}.layers.{i}", f"{ours}.layers.{i}"
            self._attention(f"{their_layer}.self_attn", f"{our_layer}.mix.attention")
            self._module(f"{their_layer}.norm1", f"{our_layer}.mix.norm")
            self._feed_forward(their_layer, f"{our_layer}.refine", "norm2")
        if self.config.pre_norm:
            self._module(f"{theirs}.norm", f"{ours}.norm")

    def _decoder(self) -> None:
        self.ours["model.decoder.start"] = self.start("decoder.layers.0")
        for i in range(self.config.n_decoder_layers):
            theirs, ours = f"decoder.layers.{i}", f"model.decoder.layers.{i}"
            if i > 0:
                self._attention(f"{theirs}.self_attn", f"{ours}.mix.attention")
                self._module(f"{theirs}.norm1", f"{ours}.mix.norm")
            self._attention(f"{theirs}.multihead_attn", f"{ours}.read.attention")
            self._module(f"{theirs}.norm2", f"{ours}.read.norm")
            self._feed_forward(theirs, f"{ours}.refine", "norm3")
        self._module("decoder.norm", "model.decoder.norm")
        self.ours["model.decoder.query_positions"] = self.take("decoder_pos_embed.weight")

    def _observations(self) -> None:
        position = self.take("encoder_1d_feature_pos_embed.weight")
        self.ours["model.style_position"] = position[:1]
        vectors = {"robot": self.config.robot_state_feature, "env": self.config.env_state_feature}
        names = [name for name, feature in vectors.items() if feature]
        if names:
            self.ours[f"{OBSERVATION}.vectors.positions"] = position[1:]
        for i, name in enumerate(names):
            self._module(f"encoder_{name}_state_input_proj", f"{OBSERVATION}.vectors.projections.{i}")
        if self.config.image_features:
            self._cameras(len(self.config.image_features))

    def _cameras(self, n_cameras: int) -> None:
        ours = f"{OBSERVATION}.cameras"
        for key in [key for key in self.theirs if key.startswith("backbone.")]:
            self.ours[f"{ours}.{key}"] = self.take(key)
        weight = self.take("encoder_img_feat_input_proj.weight")
        self.ours[f"{ours}.projection.weight"] = weight[:, :, 0, 0]
        self.ours[f"{ours}.projection.bias"] = self.take("encoder_img_feat_input_proj.bias")
        # LeRobot's cameras all look alike, as ours do at the start.
        self.ours[f"{ours}.identities"] = torch.zeros(n_cameras, self.config.dim_model)

    def _style(self) -> None:
        self.ours["model.style_token"] = self.take("encoder_latent_input_proj.bias")
        weight = self.take("encoder_latent_input_proj.weight")
        if not self.config.use_vae:
            self.without_effect["encoder_latent_input_proj.weight"] = weight  # only ever multiplies zeros
            return
        self.ours[f"{STYLE}.latent_proj.weight"] = weight
        self.ours[f"{STYLE}.cls"] = self.take("vae_encoder_cls_embed.weight")[0]
        if self.config.robot_state_feature:
            self._module("vae_encoder_robot_state_input_proj", f"{STYLE}.state_proj")
        self._module("vae_encoder_action_input_proj", f"{STYLE}.action_proj")
        self._module("vae_encoder_latent_output_proj", f"{STYLE}.posterior_proj")
        self._encoder("vae_encoder", f"{STYLE}.encoder", self.config.n_vae_encoder_layers)
        self.theirs.pop("vae_encoder_pos_enc", None)  # a fixed table, compared by tests/nn/test_positions.py
