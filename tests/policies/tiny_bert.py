"""A tiny BERT with random weights, as a folder, and its hidden states by plain matrix products."""

import json

import torch
import torch.nn.functional as F  # noqa: N812
from safetensors.torch import save_file

DIM, HEADS, HIDDEN, LAYERS, VOCABULARY, PLACES = 32, 4, 128, 2, 50, 12
SIZES = {
    "hidden_size": DIM,
    "num_attention_heads": HEADS,
    "intermediate_size": HIDDEN,
    "num_hidden_layers": LAYERS,
    "vocab_size": VOCABULARY,
    "model_type": "bert",
}


def tiny_bert(folder):
    """Write the model; returns its tensors by BERT's names."""
    generator = torch.Generator().manual_seed(0)
    shapes = {
        "embeddings.word_embeddings.weight": (VOCABULARY, DIM),
        "embeddings.position_embeddings.weight": (PLACES, DIM),
        "embeddings.token_type_embeddings.weight": (2, DIM),
        **_norm("embeddings.LayerNorm"),
        **_linear("pooler.dense", DIM, DIM),
    }
    for layer in range(LAYERS):
        of = f"encoder.layer.{layer}."
        for name in ("attention.self.query", "attention.self.key", "attention.self.value"):
            shapes |= _linear(of + name, DIM, DIM)
        shapes |= _linear(f"{of}attention.output.dense", DIM, DIM) | _norm(f"{of}attention.output.LayerNorm")
        shapes |= _linear(f"{of}intermediate.dense", DIM, HIDDEN) | _linear(f"{of}output.dense", HIDDEN, DIM)
        shapes |= _norm(f"{of}output.LayerNorm")
    tensors = {name: 0.3 * torch.randn(shape, generator=generator) for name, shape in shapes.items()}
    folder.mkdir(parents=True, exist_ok=True)
    save_file(tensors, folder / "model.safetensors")
    (folder / "config.json").write_text(json.dumps(SIZES))
    return tensors


def hidden_states(tensors, tokens, is_pad):
    """The embedded word pieces, and after each layer, as the paper writes them."""

    def linear(name, x):
        return F.linear(x, tensors[f"{name}.weight"], tensors[f"{name}.bias"])

    def norm(name, x):
        return F.layer_norm(x, (DIM,), tensors[f"{name}.weight"], tensors[f"{name}.bias"], 1e-12)

    def heads(x):
        return x.unflatten(-1, (HEADS, -1)).transpose(1, 2)

    places = tensors["embeddings.position_embeddings.weight"][: tokens.shape[1]]
    words = tensors["embeddings.word_embeddings.weight"][tokens]
    kind = tensors["embeddings.token_type_embeddings.weight"][0]
    states = [norm("embeddings.LayerNorm", words + places + kind)]
    for layer in range(LAYERS):
        of, x = f"encoder.layer.{layer}.", states[-1]
        q, k, v = (heads(linear(f"{of}attention.self.{name}", x)) for name in ("query", "key", "value"))
        scores = (q @ k.transpose(-1, -2) / (DIM // HEADS) ** 0.5).masked_fill(
            is_pad[:, None, None], float("-inf")
        )
        found = (scores.softmax(-1) @ v).transpose(1, 2).flatten(2)
        x = norm(f"{of}attention.output.LayerNorm", x + linear(f"{of}attention.output.dense", found))
        wide = F.gelu(linear(f"{of}intermediate.dense", x))
        states.append(norm(f"{of}output.LayerNorm", x + linear(f"{of}output.dense", wide)))
    return states


def _linear(name, inputs, outputs):
    return {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}


def _norm(name):
    return {f"{name}.weight": (DIM,), f"{name}.bias": (DIM,)}
