import pytest
import torch
from torch import nn

from lerobot_act_chunking.nn.observation import CameraTokens, ObservationEncoder, VectorTokens
from lerobot_act_chunking.nn.positions import image_positions

B, D = 3, 16
SHAPES = {"top": (3, 32, 64), "wrist": (3, 32, 32), "side": (3, 32, 64)}


class CountingBackbone(nn.Module):
    """Average colour of 16 x 16 cells; counts its calls."""

    def __init__(self):
        super().__init__()
        self.calls = 0

    def forward(self, images):
        self.calls += 1
        return nn.functional.avg_pool2d(images, 16)


@pytest.fixture
def cameras():
    torch.manual_seed(0)
    return CameraTokens(SHAPES, D, CountingBackbone(), channels=3)


@pytest.fixture
def images():
    return {key: torch.rand(B, *shape) for key, shape in SHAPES.items()}


def test_vectors_become_one_token_each():
    torch.manual_seed(0)
    tokens = VectorTokens({"state": 6, "velocity": 4}, D)
    vectors = {"velocity": torch.randn(B, 4), "state": torch.randn(B, 6), "unused": torch.randn(B, 2)}
    out = tokens(vectors)
    assert out.shape == (B, 2, D)
    torch.testing.assert_close(out[:, 0], tokens.projections[0](vectors["state"]))


def test_cameras_of_one_shape_share_a_backbone_call(cameras, images):
    tokens, positions = cameras(images)
    assert cameras.backbone.calls == 2
    assert tokens.shape == (B, 8 + 8 + 4, D)
    assert positions.shape == (8 + 8 + 4, D)


def test_each_cell_keeps_its_own_image(cameras, images):
    """Order: the cameras of the first shape one after the other, then the second shape's; row by row."""
    tokens, _ = cameras(images)
    start = {"top": 0, "side": 8, "wrist": 16}
    for key, first in start.items():
        row, column = 1, 1
        width = SHAPES[key][2] // 16
        colour = images[key][:, :, 16 * row : 16 * row + 16, 16 * column : 16 * column + 16].mean((2, 3))
        torch.testing.assert_close(tokens[:, first + row * width + column], cameras.projection(colour))


def test_cameras_start_alike_and_learn_an_identity(cameras, images):
    _, positions = cameras(images)
    torch.testing.assert_close(positions[:8], image_positions(2, 4, D))
    torch.testing.assert_close(positions[:8], positions[8:16])
    cameras.identities.data[2] = 5.0  # "side", third camera, second in its group
    _, moved = cameras(images)
    torch.testing.assert_close(moved[8:16], positions[8:16] + 5.0)
    torch.testing.assert_close(moved[16:], positions[16:])


def test_either_kind_may_be_absent(cameras, images):
    vectors = VectorTokens({"state": 6}, D)
    state = {"state": torch.randn(B, 1, 6)}
    images = {key: value[:, None] for key, value in images.items()}
    for encoder, n in (
        (ObservationEncoder(vectors, None), 1),
        (ObservationEncoder(None, cameras), 20),
        (ObservationEncoder(vectors, cameras), 21),
    ):
        tokens, positions = encoder(state, images)
        assert tokens.shape == (B, n, D)
        assert positions.shape == (n, D)


def test_one_step_is_the_vectors_and_the_cameras_and_nothing_else(cameras, images):
    vectors, state = VectorTokens({"state": 6}, D), torch.randn(B, 6)
    encoder = ObservationEncoder(vectors, cameras)
    tokens, positions = encoder({"state": state[:, None]}, {k: v[:, None] for k, v in images.items()})
    cells, places = cameras(images)
    assert torch.equal(tokens, torch.cat((vectors({"state": state}), cells), dim=1))
    assert torch.equal(positions, torch.cat((vectors.positions, places)))
    parts = {name.split(".")[0] for name in encoder.state_dict()}
    assert parts == {"vectors", "cameras"}
