"""From chunks to the vectors that are quantised, and back."""

from collections.abc import Callable

from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.errors import look_up

KERNEL = 5
HALVINGS = 2


class ConvEncoder(nn.Module):
    """Convolutions that halve the chunk's length twice, and a linear map of what is left."""

    def __init__(self, chunk_size: int, action_dim: int, dim: int, hidden_dim: int):
        super().__init__()
        self.layers = nn.Sequential(
            _halve(action_dim, hidden_dim),
            nn.ReLU(),
            _halve(hidden_dim, hidden_dim),
            nn.ReLU(),
            nn.Flatten(),
            nn.Linear(hidden_dim * _shortened(chunk_size), dim),
        )

    def forward(self, actions: Float[Tensor, "N C A"]) -> Float[Tensor, "N D"]:
        """One vector per chunk."""
        return self.layers(actions.mT)


class ConvDecoder(nn.Module):
    """`ConvEncoder` backwards: what doubling twice makes too long is cut off at the end."""

    def __init__(self, chunk_size: int, action_dim: int, dim: int, hidden_dim: int):
        super().__init__()
        self.chunk_size = chunk_size
        length = _shortened(chunk_size)
        self.layers = nn.Sequential(
            nn.Linear(dim, hidden_dim * length),
            nn.ReLU(),
            nn.Unflatten(1, (hidden_dim, length)),
            _double(hidden_dim, hidden_dim),
            nn.ReLU(),
            _double(hidden_dim, action_dim),
        )

    def forward(self, vectors: Float[Tensor, "N D"]) -> Float[Tensor, "N C A"]:
        """One chunk per vector."""
        return self.layers(vectors).mT[:, : self.chunk_size]


def _mlp(n_in: int, hidden_dim: int, n_out: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Linear(n_in, hidden_dim),
        nn.ReLU(),
        nn.Linear(hidden_dim, hidden_dim),
        nn.ReLU(),
        nn.Linear(hidden_dim, n_out),
    )


def _halve(n_in: int, n_out: int) -> nn.Conv1d:
    """Half the length, rounded up."""
    return nn.Conv1d(n_in, n_out, KERNEL, stride=2, padding=KERNEL // 2)


def _double(n_in: int, n_out: int) -> nn.ConvTranspose1d:
    return nn.ConvTranspose1d(n_in, n_out, KERNEL, stride=2, padding=KERNEL // 2, output_padding=1)


def _shortened(length: int) -> int:
    for _ in range(HALVINGS):
        length = -(-length // 2)
    return length


def _mlp_coders(chunk_size: int, action_dim: int, dim: int, hidden_dim: int) -> tuple[nn.Module, nn.Module]:
    flat = chunk_size * action_dim
    encoder = nn.Sequential(nn.Flatten(), _mlp(flat, hidden_dim, dim))
    return encoder, nn.Sequential(_mlp(dim, hidden_dim, flat), nn.Unflatten(1, (chunk_size, action_dim)))


def _conv_coders(chunk_size: int, action_dim: int, dim: int, hidden_dim: int) -> tuple[nn.Module, nn.Module]:
    sizes = (chunk_size, action_dim, dim, hidden_dim)
    return ConvEncoder(*sizes), ConvDecoder(*sizes)


CODERS: dict[str, Callable[[int, int, int, int], tuple[nn.Module, nn.Module]]] = {
    "mlp": _mlp_coders,
    "conv": _conv_coders,
}
"""The coders. What is listed here can be asked for as ``vqvae_coder``."""


def make_coders(
    coder: str, chunk_size: int, action_dim: int, *, dim: int, hidden_dim: int
) -> tuple[nn.Module, nn.Module]:
    """An encoder (N, C, A) -> (N, D) and its decoder.

    Args:
        coder: ``mlp`` as in VQ-BeT (and LeRobot), or ``conv`` along the chunk.
        chunk_size: C.
        action_dim: A.
        dim: D.
        hidden_dim: hidden width.

    Raises:
        ConfigurationError: for another coder.
    """
    return look_up("vqvae_coder", coder, CODERS)(chunk_size, action_dim, dim, hidden_dim)
