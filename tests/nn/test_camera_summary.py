import pytest
import torch
from torch import nn

from lerobot_act_chunking.nn.camera_summary import CameraSummaries
from lerobot_act_chunking.nn.observation import ObservationEncoder

SHAPES = {"top": (3, 24, 32), "wrist": (3, 16, 40), "front": (3, 24, 32)}
D = 16


@pytest.fixture
def cameras():
    torch.manual_seed(0)
    return CameraSummaries(SHAPES, D, nn.Conv2d(3, 5, kernel_size=8, stride=8), 5)


@pytest.fixture
def images():
    torch.manual_seed(1)
    return {key: torch.randn(3, *shape) for key, shape in SHAPES.items()}


def test_one_token_per_camera_in_the_order_of_the_keys(cameras, images):
    tokens, positions = cameras(images)
    assert tokens.shape == (3, len(SHAPES), D)
    torch.testing.assert_close(positions, cameras.identities)
    for i, key in enumerate(SHAPES):
        other = {**images, key: images[key] + 1}
        changed = (cameras(other)[0] != tokens).any(0).any(-1)
        assert changed.tolist() == [j == i for j in range(len(SHAPES))]


def test_a_token_tells_where_something_is(cameras):
    bright = {key: torch.zeros(1, *shape) for key, shape in SHAPES.items()}
    moved = {key: image.clone() for key, image in bright.items()}
    bright["top"][..., :8, :8] = 1
    moved["top"][..., 16:, 24:] = 1
    assert not torch.allclose(cameras(bright)[0], cameras(moved)[0], atol=1e-2)


def test_takes_the_place_of_cell_tokens_in_the_observation_encoder(cameras, images):
    encoder = ObservationEncoder(None, cameras)
    tokens, positions = encoder({}, {key: image[:, None] for key, image in images.items()})
    torch.testing.assert_close(tokens, cameras(images)[0])
    assert positions.shape == (len(SHAPES), D)


def test_every_parameter_learns(cameras, images):
    tokens, positions = cameras(images)
    (tokens + positions).square().sum().backward()
    assert all(p.grad is not None and p.grad.any() for p in cameras.parameters())
