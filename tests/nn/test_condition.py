import pytest
import torch
from torch import nn

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.nn.condition import (
    CameraKeypoints,
    ConditionTokens,
    ConditionVector,
    spatial_softmax,
)
from lerobot_act_chunking.nn.observation import CameraTokens

B, H, K, D = 3, 2, 5, 16
VECTORS = {"state": 6, "goal": 4}
SHAPES = {"top": (3, 32, 64), "wrist": (3, 32, 48), "side": (3, 32, 64)}
DROP = torch.tensor([True, False, True])


class CountingBackbone(nn.Module):
    """Average colour of 16 x 16 cells; counts its calls."""

    def __init__(self):
        super().__init__()
        self.calls = 0

    def forward(self, images):
        self.calls += 1
        return nn.functional.avg_pool2d(images, 16)


@pytest.fixture
def vectors():
    torch.manual_seed(0)
    return {key: torch.randn(B, H, n) for key, n in reversed(VECTORS.items())} | {
        "unused": torch.rand(B, H, 1)
    }


@pytest.fixture
def images():
    torch.manual_seed(1)
    return {key: torch.rand(B, H, *shape) for key, shape in reversed(SHAPES.items())}


def keypoints() -> CameraKeypoints:
    torch.manual_seed(2)
    return CameraKeypoints(SHAPES, K, CountingBackbone(), channels=3)


def camera_tokens() -> CameraTokens:
    torch.manual_seed(2)
    return CameraTokens(SHAPES, D, CountingBackbone(), channels=3)


def make(kind: str, null_features=()):
    if kind == "vector":
        return ConditionVector(VECTORS, H, keypoints(), null_features)
    return ConditionTokens(VECTORS, H, camera_tokens(), D, null_features)


def values(condition):
    return condition.tokens if condition.vector is None else condition.vector


def test_states_are_in_lerobots_order(vectors):
    """State and environment state of the first step, then of the next."""
    encoder = ConditionVector(VECTORS, H)
    out = encoder(vectors, {}).vector
    assert out.shape == (B, encoder.dim)
    steps = [torch.cat((vectors["state"][:, h], vectors["goal"][:, h]), dim=1) for h in range(H)]
    assert torch.equal(out, torch.cat(steps, dim=1))


def test_camera_features_follow_the_vectors_of_their_step(vectors, images):
    encoder = make("vector")
    out = encoder(vectors, images).vector
    assert out.shape == (B, encoder.dim)
    by_step = out.unflatten(1, (H, -1))
    torch.testing.assert_close(by_step[..., sum(VECTORS.values()) :], encoder.cameras(images))


def test_cameras_of_one_shape_share_a_backbone_call(images):
    cameras = keypoints()
    cameras(images)
    assert cameras.backbone.calls == 2


def test_each_camera_keeps_its_place_and_its_steps(images):
    cameras = keypoints()
    together = cameras(images).unflatten(-1, (len(SHAPES), -1))
    for i, (key, shape) in enumerate(SHAPES.items()):
        alone = CameraKeypoints({key: shape}, K, cameras.backbone, channels=3)
        alone.load_state_dict(cameras.state_dict())
        torch.testing.assert_close(together[:, :, i], alone({key: images[key]}))
        for h in range(H):
            step = alone({key: images[key][:, h : h + 1]})
            torch.testing.assert_close(together[:, h, i], step[:, 0])


@pytest.mark.parametrize(("row", "column"), [(0, 0), (2, 4), (1, 3)])
def test_spatial_softmax_finds_a_peak(row, column):
    maps = torch.zeros(1, 2, 3, 5)
    maps[0, 1, row, column] = 100.0
    x, y = -1 + 2 * column / 4, -1 + 2 * row / 2
    expected = torch.tensor([[[0.0, 0.0], [x, y]]])
    torch.testing.assert_close(spatial_softmax(maps), expected, rtol=0, atol=1e-6)


def test_tokens_have_a_place_in_time(vectors, images):
    encoder = make("tokens")
    out = encoder(vectors, images).tokens
    n = 2 + 8 + 6 + 8
    assert out.shape == (B, H * n, D)
    backwards = encoder(*({k: v.flip(1) for k, v in inputs.items()} for inputs in (vectors, images))).tokens
    swapped = torch.cat((backwards[:, n:], backwards[:, :n]), dim=1)
    difference = (out - swapped).reshape(B, H, n, D)
    time = encoder.steps[0, 0] - encoder.steps[1, 0]
    torch.testing.assert_close(difference, torch.stack((time, -time))[:, None].expand(B, H, n, D))


def test_tokens_without_cameras_or_vectors(vectors, images):
    assert ConditionTokens(VECTORS, H, None, D)(vectors, {}).tokens.shape == (B, H * 2, D)
    assert ConditionTokens({}, H, camera_tokens(), D)({}, images).tokens.shape == (B, H * 22, D)


@pytest.mark.parametrize("kind", ["vector", "tokens"])
@pytest.mark.parametrize("key", ["goal", "wrist"])
def test_inputs_left_out_do_not_matter(kind, key, vectors, images):
    encoder = make(kind, (key,))
    nn.init.constant_(encoder.null.values[0], 0.7)
    inputs = {**vectors, **images}
    other = {**inputs, key: inputs[key] + 1}
    first, second = (
        values(encoder({k: x[k] for k in vectors}, {k: x[k] for k in images}, DROP)) for x in (inputs, other)
    )
    same = (first - second).flatten(1).abs().amax(1) == 0
    assert torch.equal(same, DROP)
    kept = values(encoder(vectors, images))
    torch.testing.assert_close(first[~DROP], kept[~DROP])
    assert ((first - kept).flatten(1).abs().amax(1) > 1e-4).tolist() == DROP.tolist()


@pytest.mark.parametrize("kind", ["vector", "tokens"])
def test_stand_ins_are_learned_and_inputs_are_not_changed(kind, vectors, images):
    encoder = make(kind, ("goal", "wrist"))
    # Keypoints of one colour only move at the borders, which every real backbone pads.
    encoder.cameras.backbone = nn.Sequential(nn.AvgPool2d(16), nn.Conv2d(3, 3, 3, padding=1))
    before = {key: value.clone() for key, value in vectors.items()}
    (values(encoder(vectors, images, DROP)) + 1).square().sum().backward()
    for name, parameter in encoder.named_parameters():
        assert parameter.grad is not None, name
    assert all(value.grad.abs().max() > 0 for value in encoder.null.values)
    assert all(torch.equal(vectors[key], value) for key, value in before.items())


@pytest.mark.parametrize("kind", ["vector", "tokens"])
def test_only_inputs_can_be_left_out(kind):
    with pytest.raises(
        ConfigurationError, match="null_features has 'gaol'; the inputs are: state, goal, top"
    ):
        make(kind, ("gaol",))
