"""Which codes come next: their logits, their loss, and how to choose among them."""

import torch
import torch.nn.functional as F  # noqa: N812
from jaxtyping import Float, Int64
from torch import Tensor, nn

INIT_STD = 0.02


class CodeHead(nn.Module):
    """Logits of G codes of M values each, from one feature (VQ-BeT, Lee et al. 2024, section 3.3).

    In parallel, all codes follow from the feature alone. In sequence, each also sees the codes before it: the
    feature, a vector of its level and one vector for each earlier code are summed and go through the trunk
    that all levels share. LeRobot's sequential head is the case of two levels without hidden layers.

    Args:
        dim: width D of features.
        hidden_dims: hidden layers of the trunk.
        n_codes: G.
        vocabulary: M.
        sequential: whether a code sees those before it.
    """

    def __init__(
        self, dim: int, hidden_dims: tuple[int, ...], n_codes: int, vocabulary: int, *, sequential: bool
    ):
        super().__init__()
        self.n_codes, self.vocabulary = n_codes, vocabulary
        self.trunk, width = make_trunk(dim, hidden_dims)
        self.readout = nn.Linear(width, n_codes * vocabulary)
        self.context = CodeContext(dim, n_codes, vocabulary) if sequential else None

    def logits(self, features: Float[Tensor, "N D"], codes: Int64[Tensor, "N G"]) -> Float[Tensor, "N G M"]:
        """Logits of all codes; in sequence, each given the ``codes`` before it (teacher forcing)."""
        if self.context is None:
            return self._parallel(features)
        hidden = self.trunk(features[:, None] + self.context(codes))
        weight, bias = self._readouts
        return torch.einsum("ngd,gmd->ngm", hidden, weight) + bias

    def sample(
        self, features: Float[Tensor, "N D"], draws: Float[Tensor, "N G"], *, temperature: float, top_p: float
    ) -> Int64[Tensor, "N G"]:
        """Codes that the uniform numbers ``draws`` choose; see `inverse_cdf_index`."""
        if self.context is None:
            return inverse_cdf_index(self._parallel(features), draws, temperature=temperature, top_p=top_p)
        codes = []
        for level, (weight, bias) in enumerate(zip(*self._readouts, strict=True)):
            seen = features + self.context.levels[level]
            logits = F.linear(self.trunk(seen), weight, bias)
            codes.append(inverse_cdf_index(logits, draws[:, level], temperature=temperature, top_p=top_p))
            if level < self.n_codes - 1:
                features = features + self.context.values[level, codes[-1]]
        return torch.stack(codes, dim=1)

    def _parallel(self, features: Float[Tensor, "N D"]) -> Float[Tensor, "N G M"]:
        return self.readout(self.trunk(features)).unflatten(-1, (self.n_codes, self.vocabulary))

    @property
    def _readouts(self) -> tuple[Float[Tensor, "G M width"], Float[Tensor, "G M"]]:
        shape = self.n_codes, self.vocabulary
        return self.readout.weight.unflatten(0, shape), self.readout.bias.unflatten(0, shape)


class CodeContext(nn.Module):
    """What each level knows beside the feature: which level it is, and the codes before it."""

    def __init__(self, dim: int, n_codes: int, vocabulary: int):
        super().__init__()
        self.levels = nn.Parameter(INIT_STD * torch.randn(n_codes, dim))
        self.values = nn.Parameter(INIT_STD * torch.randn(n_codes - 1, vocabulary, dim))

    def forward(self, codes: Int64[Tensor, "N G"]) -> Float[Tensor, "N G D"]:
        """The vector of each level, with those of the codes before it."""
        earlier = codes[:, :-1] + self.values.shape[1] * torch.arange(len(self.values), device=codes.device)
        seen = F.embedding(earlier, self.values.flatten(0, 1)).cumsum(dim=1)
        return self.levels + F.pad(seen, (0, 0, 1, 0))


def make_trunk(dim: int, hidden_dims: tuple[int, ...]) -> tuple[nn.Sequential, int]:
    """Linear layers of these widths, with GELU behind each, and the width of the last."""
    widths = (dim, *hidden_dims)
    layers: list[nn.Module] = []
    for n_in, n_out in zip(widths, hidden_dims, strict=False):
        layers += [nn.Linear(n_in, n_out), nn.GELU()]
    return nn.Sequential(*layers), widths[-1]


def inverse_cdf_index(
    logits: Float[Tensor, "*N M"], draws: Float[Tensor, "*N"], *, temperature: float, top_p: float
) -> Int64[Tensor, "*N"]:
    """Sample by inverse transform: the code in whose share of [0, 1) the draw lies.

    Args:
        logits: of M codes.
        draws: uniform in [0, 1).
        temperature: divides the logits; 0 takes the likeliest.
        top_p: in (0, 1]: only the fewest codes that together have this probability (nucleus sampling,
            Holtzman et al. 2020).
    """
    if temperature == 0:
        return logits.argmax(-1)
    logits = logits.float()
    probabilities = ((logits - logits.amax(-1, keepdim=True)) / temperature).softmax(-1)
    if top_p < 1:
        probabilities = _nucleus(probabilities, top_p)
    cumulative = probabilities.cumsum(-1).masked_fill(probabilities == 0, 0)
    total = cumulative.amax(-1, keepdim=True)
    below_total = total.nextafter(torch.zeros_like(total))  # rounding may bring a draw just below 1 to it
    threshold = (draws.to(total)[..., None] * total).minimum(below_total)
    return (cumulative > threshold).int().argmax(-1)


def _nucleus(probabilities: Float[Tensor, "*N M"], top_p: float) -> Float[Tensor, "*N M"]:
    """Probabilities (unnormalised) of the likeliest codes; 0 where likelier ones reach ``top_p`` already."""
    ranked, order = probabilities.sort(dim=-1, descending=True, stable=True)
    ranked = ranked.masked_fill(ranked.cumsum(-1) - ranked >= top_p, 0)
    return torch.zeros_like(probabilities).scatter(-1, order, ranked)


def focal_loss(
    logits: Float[Tensor, "*N M"], codes: Int64[Tensor, "*N"], gamma: float
) -> Float[Tensor, "*N"]:
    """``-(1 - p)^gamma log p`` of the right code (Lin et al. 2017, eq. 4); gamma 0 is cross-entropy.

    ``1 - p`` is kept above 0, where the gradient of its power would be infinite for gamma below 1.
    """
    log_p = logits.log_softmax(-1).gather(-1, codes[..., None])[..., 0]
    missing = (-log_p.expm1()).clamp_min(torch.finfo(log_p.dtype).tiny)
    return -(missing**gamma) * log_p
