"""A decoder whose action queries know the actions before them."""

from collections.abc import Callable

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.attention import Attention
from lerobot_act_chunking.nn.layers import LayerSpec
from lerobot_act_chunking.nn.processes import draw_rows
from lerobot_act_chunking.nn.transformer import DecoderLayer, init_like_act

Memory = tuple[Float[Tensor, "B H N d"], Float[Tensor, "B H N d"]]  # keys and values of one attention


class AutoregressiveDecoder(nn.Module):
    """p(chunk | memory) as a product over queries, each given the actions that earlier ones emitted.

    A query emits a block of ``actions_per_query`` consecutive actions. Its token is the block before it (a
    learned start for the first one), placed by a learned position. Training shows all demonstrated blocks at
    once (teacher forcing) behind a causal mask; acting feeds back what it has chosen, one query after the
    other, and keeps the keys and values of those before ("Attention Is All You Need", section 3.2.3).

    Args:
        spec: of the layers.
        n_layers: how many.
        n_queries: Q.
        actions_per_query: s, actions in a block.
        action_dim: A.
    """

    def __init__(
        self, spec: LayerSpec, n_layers: int, n_queries: int, actions_per_query: int, action_dim: int
    ):
        super().__init__()
        self.actions_per_query = actions_per_query
        self.start = nn.Parameter(torch.randn(spec.dim))
        self.hidden = nn.Parameter(torch.randn(spec.dim))
        self.block_proj = nn.Linear(actions_per_query * action_dim, spec.dim)
        self.query_positions = nn.Parameter(torch.randn(n_queries, spec.dim))
        self.layers = nn.ModuleList(DecoderLayer(spec, queries_interact=True) for _ in range(n_layers))
        self.norm = nn.LayerNorm(spec.dim)
        init_like_act(self)

    def forward(
        self,
        memory: Float[Tensor, "B N D"],
        memory_positions: Float[Tensor, "N D"],
        actions: Float[Tensor, "B T A"],
        keep: Bool[Tensor, "B Q"] | None = None,
    ) -> Float[Tensor, "B Q D"]:
        """Features of all queries, each given the demonstrated actions before its own.

        Args:
            memory: what the policy knows.
            memory_positions: positions of its tokens.
            actions: the demonstrated chunk.
            keep: queries whose actions are shown to those behind them (all by default); a learned vector
                stands for the others.
        """
        blocks = self.block_proj(actions.unflatten(1, (-1, self.actions_per_query)).flatten(2))
        if keep is not None:
            blocks = torch.where(keep[..., None], blocks, self.hidden.to(blocks))
        start = self.start.to(blocks).expand(len(blocks), 1, -1)
        x = torch.cat((start, blocks[:, :-1]), dim=1)
        memory_keys = memory + memory_positions
        for layer in self.layers:
            x = layer(x, self.query_positions, memory_keys, memory, causal=True)
        return self.norm(x)

    def generate(
        self,
        memory: Float[Tensor, "B N D"],
        memory_positions: Float[Tensor, "N D"],
        n_queries: int,
        act: Callable[[Float[Tensor, "B 1 D"]], Float[Tensor, "B s A"]],
    ) -> Float[Tensor, "B T A"]:
        """Actions of the first ``n_queries`` queries, chosen one block after the other.

        Args:
            memory: what the policy knows.
            memory_positions: positions of its tokens.
            n_queries: blocks needed.
            act: chooses a block from its query's features.
        """
        memory_keys = memory + memory_positions
        layers = [layer for layer in self.layers if isinstance(layer, DecoderLayer)]
        read = [layer.read.attention.project_keys_values(memory_keys, memory) for layer in layers]
        earlier = [KeptKeys(n_queries) for _ in layers]
        x, blocks = self.start.expand(len(memory), 1, -1), []
        for position in self.query_positions[:n_queries, None]:
            for layer, kept, known in zip(layers, earlier, read, strict=True):
                x = _next(layer, x, position, kept, known)
            blocks.append(act(self.norm(x)))
            x = self.block_proj(blocks[-1].to(memory).flatten(1))[:, None]
        return torch.cat(blocks, dim=1)


class KeptKeys:
    """Keys and values of the queries so far, in tensors that hold all.

    Args:
        n_queries: how many there will be.
    """

    def __init__(self, n_queries: int):
        self.n_queries = n_queries
        self.n_kept = 0

    def add(self, keys: Float[Tensor, "B H 1 d"], values: Float[Tensor, "B H 1 d"]) -> Memory:
        """Keep one more query's; returns all so far."""
        if self.n_kept == 0:
            self._keys, self._values = (
                each.new_empty(*each.shape[:2], self.n_queries, each.shape[-1]) for each in (keys, values)
            )
        self._keys[:, :, self.n_kept] = keys[:, :, 0]
        self._values[:, :, self.n_kept] = values[:, :, 0]
        self.n_kept += 1
        return self._keys[:, :, : self.n_kept], self._values[:, :, : self.n_kept]


def _next(
    layer: DecoderLayer,
    x: Float[Tensor, "B 1 D"],
    position: Float[Tensor, "1 D"],
    kept: KeptKeys,
    known: Memory,
) -> Float[Tensor, "B 1 D"]:
    """What a decoder layer makes of the next query, given those before."""

    mix = layer.mix
    assert mix is not None  # noqa: S101  (queries interact)

    def attend_back(y: Tensor, attention: Attention = mix.attention) -> Tensor:
        return attention.attend(y + position, *kept.add(*attention.project_keys_values(y + position, y)))

    x = mix.add(x, attend_back)
    x = layer.read.add(x, lambda y: layer.read.attention.attend(y + position, *known))
    return layer.refine(x)


def corrupt(
    actions: Float[Tensor, "B T A"],
    actions_per_query: int,
    generator: torch.Generator,
    noise_std: float,
    dropout: float,
) -> tuple[Float[Tensor, "B T A"], Bool[Tensor, "B Q"]]:
    """Demonstrated actions as training shows them, and the queries whose block it shows.

    A block all but says the next one, so that a decoder which only ever sees perfect ones learns to copy, and
    its own small errors add up when it acts (exposure bias). Noise and hidden blocks make it look at the
    observation.

    Args:
        actions: normalised.
        actions_per_query: actions in a block; divides T.
        generator: of the noise, on the device of ``actions``.
        noise_std: of the noise, in normalised units.
        dropout: probability that a block is hidden.
    """
    source = {"generator": generator, "device": actions.device}
    noise = draw_rows(torch.randn, actions.shape, dtype=actions.dtype, **source)
    shape = len(actions), actions.shape[1] // actions_per_query
    keep = draw_rows(torch.rand, shape, **source) >= dropout
    return actions + noise_std * noise, keep
