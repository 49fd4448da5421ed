import pytest
import torch
from torch import nn

from lerobot_act_chunking.nn.cpu.span import Span, embedded, join

B, N, R, D = 3, 7, 4, 16


@pytest.fixture(params=[(R, D), (B, R, D)], ids=["shared", "each"])
def span(request):
    torch.manual_seed(0)
    return Span(torch.randn(B, N, R), torch.randn(request.param))


def test_a_linear_layer_sees_the_vectors_only(span):
    layer, positions = nn.Linear(D, 5), torch.randn(N, D)
    torch.testing.assert_close(span.through(layer), layer(span.tokens()))
    torch.testing.assert_close(span.through(layer, positions), layer(span.tokens() + positions))


def test_without_a_bias(span):
    layer = nn.Linear(D, 5, bias=False)
    torch.testing.assert_close(span.through(layer), layer(span.tokens()))


def test_a_norm_keeps_the_span(span):
    norm = nn.LayerNorm(D)
    nn.init.normal_(norm.weight)
    nn.init.normal_(norm.bias)
    torch.testing.assert_close(span.normalized(norm).tokens(), norm(span.tokens()))


def test_embeddings_one_behind_the_other():
    torch.manual_seed(0)
    first, second = nn.Linear(2, D), nn.Linear(3, D)
    x, y = torch.randn(B, 1, 2), torch.randn(B, N, 3)
    tokens = join(embedded(first, x), embedded(second, y)).tokens()
    torch.testing.assert_close(tokens, torch.cat((first(x), second(y)), dim=1))
