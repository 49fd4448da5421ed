"""The declared map from the parameters of LeRobot's ``act`` to those of ``act_chunked``.

Every key of LeRobot's state dict is consumed exactly once, either mapped or dropped with a reason; what is
left over, or missing on our side, is an error.
"""

import torch
import torch.nn.functional as F  # noqa: N812
from lerobot.policies.act.modeling_act import ACTPolicy
from torch import Tensor

OBSERVATION = "model.observation_encoder"
STYLE = "model.style_encoder"


class Map:
    """Moves entries from LeRobot's dictionary (weights, or gradients under the weights' names) to ours."""

    def __init__(self, theirs: dict[str, Tensor], policy: ACTPolicy):
        self.theirs = {key.removeprefix("model."): value for key, value in theirs.items()}
        self.policy = policy
        self.ours: dict[str, Tensor] = {}
        self.without_effect: dict[str, Tensor] = {}

    def take(self, key: str) -> Tensor:
        return self.theirs.pop(key)

    def drop(self, key: str) -> None:
        self.without_effect[key] = self.take(key)

    def module(self, theirs: str, ours: str, names: tuple[str, ...] = ("weight", "bias")) -> None:
        for name in names:
            self.ours[f"{ours}.{name}"] = self.take(f"{theirs}.{name}")

    def attention(self, theirs: str, ours: str) -> None:
        q, k, v = self.take(f"{theirs}.in_proj_weight").chunk(3)
        q_bias, k_bias, v_bias = self.take(f"{theirs}.in_proj_bias").chunk(3)
        self.without_effect[f"{theirs}.in_proj_bias[keys]"] = k_bias  # cancelled by the softmax
        self.ours |= {f"{ours}.q_proj.weight": q, f"{ours}.k_proj.weight": k, f"{ours}.v_proj.weight": v}
        self.ours |= {f"{ours}.q_proj.bias": q_bias, f"{ours}.v_proj.bias": v_bias}
        self.module(f"{theirs}.out_proj", f"{ours}.out_proj")

    def feed_forward(self, theirs: str, ours: str, norm: str) -> None:
        self.module(f"{theirs}.linear1", f"{ours}.expand")
        self.module(f"{theirs}.linear2", f"{ours}.contract")
        self.module(f"{theirs}.{norm}", f"{ours}.norm")

    def encoder(self, theirs: str, ours: str, n_layers: int) -> None:
        for i in range(n_layers):
            their_layer, our_layer = f"{theirs}.layers.{i}", f"{ours}.layers.{i}"
            self.attention(f"{their_layer}.self_attn", f"{our_layer}.mix.attention")
            self.module(f"{their_layer}.norm1", f"{our_layer}.mix.norm")
            self.feed_forward(their_layer, f"{our_layer}.refine", "norm2")
        if self.policy.config.pre_norm:
            self.module(f"{theirs}.norm", f"{ours}.norm")

    def decoder(self, n_layers: int, *, gradients: bool) -> None:
        self.ours["model.decoder.start"] = self._start("decoder.layers.0", gradients=gradients)
        for i in range(n_layers):
            theirs, ours = f"decoder.layers.{i}", f"model.decoder.layers.{i}"
            if i > 0:
                self.attention(f"{theirs}.self_attn", f"{ours}.mix.attention")
                self.module(f"{theirs}.norm1", f"{ours}.mix.norm")
            self.attention(f"{theirs}.multihead_attn", f"{ours}.read.attention")
            self.module(f"{theirs}.norm2", f"{ours}.read.norm")
            self.feed_forward(theirs, f"{ours}.refine", "norm3")
        self.module("decoder.norm", "model.decoder.norm")
        self.ours["model.decoder.query_positions"] = self.take("decoder_pos_embed.weight")

    def _start(self, layer: str, *, gradients: bool) -> Tensor:
        """The first self-attention sub-layer, which acts on zeros, in closed form."""
        dim = self.policy.config.dim_model
        in_weight, in_bias = (
            self.take(f"{layer}.self_attn.in_proj_weight"),
            self.take(f"{layer}.self_attn.in_proj_bias"),
        )
        out_weight, out_bias = (
            self.take(f"{layer}.self_attn.out_proj.{name}") for name in ("weight", "bias")
        )
        scale, shift = self.take(f"{layer}.norm1.weight"), self.take(f"{layer}.norm1.bias")
        self.without_effect[f"{layer}.self_attn.in_proj_weight[queries, keys]"] = in_weight[: 2 * dim]
        pre_norm = self.policy.config.pre_norm
        if gradients:  # the constant's own gradient arrives at the last addition that forms it
            return out_bias if pre_norm else shift
        value = in_bias[2 * dim :] + (in_weight[2 * dim :] @ shift if pre_norm else 0)
        constant = out_weight @ value + out_bias
        return constant if pre_norm else F.layer_norm(constant, (dim,), scale, shift)

    def observations(self) -> None:
        config = self.policy.config
        vectors = [
            key
            for key, there in (("robot", config.robot_state_feature), ("env", config.env_state_feature))
            if there
        ]
        position = self.take("encoder_1d_feature_pos_embed.weight")
        self.ours["model.style_position"] = position[:1]
        self.ours[f"{OBSERVATION}.vectors.positions"] = position[1:]
        for i, key in enumerate(vectors):
            self.module(f"encoder_{key}_state_input_proj", f"{OBSERVATION}.vectors.projections.{i}")
        if config.image_features:
            self.cameras(len(config.image_features))

    def cameras(self, n_cameras: int) -> None:
        ours = f"{OBSERVATION}.cameras"
        for key in [key for key in self.theirs if key.startswith("backbone.")]:
            self.ours[f"{ours}.{key}"] = self.take(key)
        self.ours[f"{ours}.projection.weight"] = self.take("encoder_img_feat_input_proj.weight")[:, :, 0, 0]
        self.ours[f"{ours}.projection.bias"] = self.take("encoder_img_feat_input_proj.bias")
        # LeRobot's cameras have no identity: where it starts, at zero.
        self.ours[f"{ours}.identities"] = torch.zeros(n_cameras, self.policy.config.dim_model)

    def style(self) -> None:
        self.ours["model.style_token"] = self.take("encoder_latent_input_proj.bias")
        if not self.policy.config.use_vae:
            self.drop("encoder_latent_input_proj.weight")  # only ever multiplies zeros
            return
        self.ours[f"{STYLE}.latent_proj.weight"] = self.take("encoder_latent_input_proj.weight")
        self.ours[f"{STYLE}.cls"] = self.take("vae_encoder_cls_embed.weight")[0]
        self.module("vae_encoder_robot_state_input_proj", f"{STYLE}.state_proj")
        self.module("vae_encoder_action_input_proj", f"{STYLE}.action_proj")
        self.module("vae_encoder_latent_output_proj", f"{STYLE}.posterior_proj")
        self.encoder("vae_encoder", f"{STYLE}.encoder", self.policy.config.n_vae_encoder_layers)
        self.theirs.pop("vae_encoder_pos_enc", None)  # a fixed table, compared by tests/nn/test_positions.py


def convert(
    theirs: dict[str, Tensor], policy: ACTPolicy, *, gradients: bool = False
) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Our state dict (or gradients), and LeRobot's entries that have no effect on any output."""
    mapping = Map(theirs, policy)
    mapping.style()
    mapping.observations()
    mapping.encoder("encoder", "model.encoder", policy.config.n_encoder_layers)
    mapping.decoder(policy.config.n_decoder_layers, gradients=gradients)
    mapping.module("action_head", "model.head.projection")
    assert not mapping.theirs, f"left over: {list(mapping.theirs)}"
    return mapping.ours, mapping.without_effect
