import pytest
import torch
from torch import nn

from lerobot_act_chunking.nn.condition import CameraKeypoints
from lerobot_act_chunking.nn.history import HistoryTokens

B, H, K, D = 3, 2, 5, 16
VECTORS = {"state": 6, "goal": 4}
SHAPES = {"top": (3, 32, 64), "wrist": (3, 32, 48), "side": (3, 32, 64)}


def keypoints(keys=tuple(SHAPES)):
    torch.manual_seed(0)
    backbone = nn.Sequential(nn.Conv2d(3, 7, 16, stride=16), nn.Tanh())
    return CameraKeypoints({key: SHAPES[key] for key in keys}, K, backbone, channels=7)


def observations():
    generator = torch.Generator().manual_seed(1)
    vectors = {key: torch.randn(B, H, n, generator=generator) for key, n in reversed(VECTORS.items())}
    images = {key: torch.rand(B, H, *shape, generator=generator) for key, shape in reversed(SHAPES.items())}
    return vectors, images


@pytest.mark.parametrize(
    ("vectors", "cameras"),
    [(VECTORS, ()), ({"goal": 4}, ()), ({}, ("wrist",)), ({}, tuple(SHAPES)), (VECTORS, ("top", "wrist"))],
)
def test_any_number_of_inputs(vectors, cameras):
    history = HistoryTokens(vectors, keypoints(cameras) if cameras else None, D)
    assert history.n_tokens == len(vectors) + len(cameras)
    assert history(*observations()).shape == (B, H, history.n_tokens, D)
    assert (history.cameras is None) == (not cameras)


@pytest.mark.parametrize("key", [*SHAPES, *VECTORS])
@pytest.mark.parametrize("step", range(H))
def test_an_input_is_one_token_at_its_step(key, step):
    """Cameras first, then vectors, in the order of construction whatever the order of the batch."""
    history = HistoryTokens(VECTORS, keypoints(), D)
    vectors, images = observations()
    before = history(vectors, images)
    (vectors if key in vectors else images)[key][:, step] *= -1
    changed = (history(vectors, images) - before).abs().amax((0, 3)) > 1e-6
    places = [(h, n) for h in range(H) for n, name in enumerate([*SHAPES, *VECTORS]) if changed[h, n]]
    assert places == [(step, [*SHAPES, *VECTORS].index(key))]


def test_cameras_share_backbone_keypoints_and_projection():
    history = HistoryTokens({}, keypoints(), D)
    _, images = observations()
    images["side"] = images["top"]
    tokens = history({}, images)
    assert torch.equal(tokens[:, :, 0], tokens[:, :, 2])


def test_every_parameter_learns():
    history = HistoryTokens(VECTORS, keypoints(), D)
    history(*observations()).square().sum().backward()
    assert all(parameter.grad.abs().sum() > 0 for parameter in history.parameters())


def test_images_seen_one_by_one_are_the_same_tokens():
    history = HistoryTokens(VECTORS, keypoints(), D)
    vectors, images = observations()
    steps = [
        history.image_features({key: image[:, h : h + 1] for key, image in images.items()}) for h in range(H)
    ]
    seen = {key: torch.cat([step[key] for step in steps], dim=1) for key in SHAPES}
    torch.testing.assert_close(history(vectors | seen, {}), history(vectors, images))
