"""Which codes come next: their logits, their loss, and how to choose among them."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor, nn


class CodeHead(nn.Module):
    """Logits of G codes of M values each, from one feature.

    In parallel, all codes follow from the feature alone. In sequence each also sees those before it, as
    further codes refine earlier ones (``sequentially_select``).

    Args:
        dim: width D of features.
        hidden_dims: hidden layers.
        n_codes: G.
        vocabulary: M.
        sequential: whether a code sees those before it.
    """

    def __init__(
        self, dim: int, hidden_dims: tuple[int, ...], n_codes: int, vocabulary: int, *, sequential: bool
    ):
        super().__init__()
        self.n_codes, self.vocabulary = n_codes, vocabulary
        self.trunk = make_trunk(dim, hidden_dims)
        width = hidden_dims[-1] if hidden_dims else dim
        self.readout = nn.Linear(width, n_codes * vocabulary)
        self.earlier = nn.Parameter(0.02 * torch.randn(n_codes - 1, vocabulary, dim)) if sequential else None
        self.levels = nn.Parameter(0.02 * torch.randn(n_codes, dim)) if sequential else None

    def logits(
        self, features: Float[Tensor, "N D"], codes: Int64[Tensor, "N G"] | None = None
    ) -> Float[Tensor, "N G M"]:
        """Logits of all codes; in sequence, each given the ``codes`` before it."""
        if self.levels is None or self.earlier is None:
            return self.readout(self.trunk(features)).unflatten(-1, (self.n_codes, self.vocabulary))
        seen = features[:, None] + self.levels
        if self.n_codes > 1:
            assert codes is not None
            level = torch.arange(self.n_codes - 1, device=features.device)
            embedded = self.earlier[level, codes[:, :-1]].cumsum(1)
            seen = torch.cat((seen[:, :1], seen[:, 1:] + embedded), dim=1)
        hidden = self.trunk(seen)
        weight = self.readout.weight.unflatten(0, (self.n_codes, self.vocabulary))
        bias = self.readout.bias.unflatten(0, (self.n_codes, self.vocabulary))
        return torch.einsum("ngd,gmd->ngm", hidden, weight) + bias

    def sample(
        self, features: Float[Tensor, "N D"], draws: Float[Tensor, "N G"], *, temperature: float, top_p: float
    ) -> Int64[Tensor, "N G"]:
        """Codes by inverse transform of the uniform ``draws``; see `pick`."""
        if self.levels is None or self.earlier is None:
            return pick(self.logits(features), draws, temperature=temperature, top_p=top_p)
        weight = self.readout.weight.unflatten(0, (self.n_codes, self.vocabulary))
        bias = self.readout.bias.unflatten(0, (self.n_codes, self.vocabulary))
        codes, seen = [], features
        for g in range(self.n_codes):
            logits = nn.functional.linear(self.trunk(seen + self.levels[g]), weight[g], bias[g])
            codes.append(pick(logits, draws[:, g], temperature=temperature, top_p=top_p))
            if g + 1 < self.n_codes:
                seen = seen + self.earlier[g, codes[-1]]
        return torch.stack(codes, dim=1)


def make_trunk(dim: int, hidden_dims: tuple[int, ...]) -> nn.Sequential:
    """Linear layers of these widths, with GELU behind each."""
    widths = (dim, *hidden_dims)
    layers: list[nn.Module] = []
    for n_in, n_out in zip(widths, hidden_dims, strict=False):
        layers += [nn.Linear(n_in, n_out), nn.GELU()]
    return nn.Sequential(*layers)


def pick(
    logits: Float[Tensor, "*N M"], draws: Float[Tensor, "*N"], *, temperature: float, top_p: float
) -> Int64[Tensor, "*N"]:
    """Sample by inverse transform: the code in whose share of [0, 1) the draw lies.

    Args:
        logits: of M codes.
        draws: uniform in [0, 1).
        temperature: divides the logits; 0 takes the likeliest.
        top_p: only the likeliest codes that together have this probability (at least one).
    """
    if temperature == 0:
        return logits.argmax(-1)
    probabilities = (logits.float() / temperature).softmax(-1)
    if top_p < 1:
        ranked, order = probabilities.sort(-1, descending=True)
        ranked = ranked * (ranked.cumsum(-1) - ranked < top_p)
        probabilities = torch.zeros_like(probabilities).scatter(-1, order, ranked)
    cumulative = probabilities.cumsum(-1)
    threshold = draws[..., None].to(cumulative) * cumulative[..., -1:]
    last = (probabilities > 0).long() * torch.arange(logits.shape[-1], device=logits.device)
    return (cumulative <= threshold).sum(-1).minimum(last.amax(-1))


def focal_loss(
    logits: Float[Tensor, "*N M"], codes: Int64[Tensor, "*N"], gamma: float
) -> Float[Tensor, "*N"]:
    """``-(1 - p)^gamma log p`` of the right code (Lin et al. 2017); gamma 0 is cross-entropy."""
    log_p = logits.log_softmax(-1).gather(-1, codes[..., None])[..., 0]
    return -((1 - log_p.exp()) ** gamma) * log_p
