"""The declared map from the parameters of LeRobot's ``vqbet`` to those of ``vqbet_chunked``.

Every key of LeRobot's state dict is consumed exactly once, either mapped or dropped with a reason; what is
left over, or missing on our side, is an error. LeRobot's ``wte`` and ``lm_head`` are multiplied into the
linear maps before and behind them. The map is differentiable: through it, the gradients of our loss are
gradients of LeRobot's own parameters.
"""

from torch import Tensor

RESNET = {0: "conv1", 1: "bn1", 4: "layer1", 5: "layer2", 6: "layer3", 7: "layer4"}


class Map:
    """Moves entries from LeRobot's dictionary of weights to ours."""

    def __init__(self, theirs: dict[str, Tensor]):
        self.theirs = dict(theirs)
        self.ours: dict[str, Tensor] = {}

    def take(self, key: str) -> Tensor:
        return self.theirs.pop(key)

    def drop(self, *endings: str) -> None:
        for key in [key for key in self.theirs if key.endswith(endings)]:
            self.take(key)

    def module(self, theirs: str, ours: str) -> None:
        for name in ("weight", "bias"):
            self.ours[f"{ours}.{name}"] = self.take(f"{theirs}.{name}")

    def gpt(self, theirs: str, ours: str, n_tokens: int) -> None:
        """The GPT without ``wte`` and ``lm_head``; positions beyond our longest sequence are never read."""
        self.ours[f"{ours}positions"] = self.take(f"{theirs}transformer.wpe.weight")[:n_tokens]
        self.module(f"{theirs}transformer.ln_f", f"{ours}norm")
        names = {"ln_1": "norm1", "attn.c_attn": "qkv", "attn.c_proj": "mix", "ln_2": "norm2"}
        names |= {"mlp.0": "expand", "mlp.2": "contract"}
        layers = {key.split(".h.")[1].split(".")[0] for key in self.theirs if ".h." in f".{key}"}
        for i in sorted(layers):
            self.drop(f"transformer.h.{i}.attn.bias")  # the causal mask
            for their_name, our_name in names.items():
                self.module(f"{theirs}transformer.h.{i}.{their_name}", f"{ours}blocks.{i}.{our_name}")

    def inputs(self, projections: dict[str, str], query: tuple[str, str]) -> None:
        """Projections and the action query, each multiplied with ``wte``."""
        weight, bias = (self.take(f"policy.transformer.wte.{name}") for name in ("weight", "bias"))
        for theirs, ours in projections.items():
            self.ours[f"{ours}.weight"] = weight @ self.take(f"{theirs}.weight")
            self.ours[f"{ours}.bias"] = weight @ self.take(f"{theirs}.bias") + bias
        self.ours[query[1]] = weight @ self.take(query[0])[0, 0] + bias

    def outputs(self, heads: dict[str, str]) -> None:
        """The linear heads, each multiplied with ``lm_head``."""
        weight = self.take("policy.lm_head.weight")
        for theirs, ours in heads.items():
            self.ours[f"{ours}.weight"] = self.take(f"{theirs}.weight") @ weight
            self.ours[f"{ours}.bias"] = self.take(f"{theirs}.bias")

    def cameras(self, theirs: str, ours: str) -> None:
        self.drop("num_batches_tracked", "pos_grid")  # a counter; a fixed grid
        self.module(f"{theirs}pool.nets", f"{ours}attention")
        self.module(f"{theirs}out", f"{ours}projection")
        for i, name in RESNET.items():
            prefix = f"{theirs}backbone.{i}."
            for key in [key for key in self.theirs if key.startswith(prefix)]:
                self.ours[f"{ours}backbone.{name}.{key.removeprefix(prefix)}"] = self.take(key)

    def tokenizer(self, theirs: str, ours: str) -> None:
        self.drop("discretized", "freeze_codebook")  # our phase has its own counter
        for i in (0, 2, 4):
            self.module(f"{theirs}encoder.{i}", f"{ours}encoder.1.{i}")
            self.module(f"{theirs}decoder.{i}", f"{ours}decoder.0.{i}")
        prefix = f"{theirs}vq_layer.layers."
        for key in [key for key in self.theirs if key.startswith(prefix)]:
            value = self.take(key)
            value = value.bool()[0] if key.endswith("initted") else value
            self.ours[f"{ours}quantizer.levels.layers.{key.removeprefix(prefix)}"] = value


def convert(theirs: dict[str, Tensor], n_tokens: int) -> dict[str, Tensor]:
    """Our ``model`` and ``tokenizer`` entries from those of LeRobot's policy; at most ``n_tokens`` tokens."""
    mapping = Map({key.removeprefix("vqbet."): value for key, value in theirs.items()})
    mapping.drop("select_target_actions_indices")  # our windows, compared by tests/data/test_timing.py
    mapping.cameras("rgb_encoder.", "model.history.cameras.")
    projections = {"state_projector.0": "history.vectors.0", "rgb_feature_projector.0": "history.images"}
    mapping.inputs(
        {theirs: f"model.{ours}" for theirs, ours in projections.items()}, ("action_token", "model.query")
    )
    mapping.gpt("policy.", "model.gpt.", n_tokens)
    mapping.outputs(
        {
            "action_head.map_to_cbet_preds_bin.0": "model.code_head.readout",
            "action_head.map_to_cbet_preds_offset.0": "model.offset_head.readout",
        }
    )
    mapping.tokenizer("action_head.vqvae_model.", "tokenizer.")
    assert not mapping.theirs, f"left over: {list(mapping.theirs)}"
    return mapping.ours


def convert_gpt(theirs: dict[str, Tensor], n_tokens: int) -> dict[str, Tensor]:
    """`Gpt` entries from those of LeRobot's GPT, whose ``wte`` and ``lm_head`` are the caller's."""
    mapping = Map(theirs)
    mapping.drop("wte.weight", "wte.bias", "lm_head.weight")
    mapping.gpt("", "", n_tokens)
    assert not mapping.theirs, f"left over: {list(mapping.theirs)}"
    return mapping.ours
