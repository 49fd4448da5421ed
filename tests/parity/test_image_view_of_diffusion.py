"""Resizing and cropping are those of LeRobot's `diffusion`, whose names the settings have."""

import pytest
import torch
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.policies.diffusion.configuration_diffusion import DiffusionConfig
from lerobot.policies.diffusion.modeling_diffusion import DiffusionRgbEncoder

from lerobot_act_chunking.nn.image_view import ImageView


@pytest.fixture(scope="module")
def encoder():
    config = DiffusionConfig(resize_shape=(40, 50), crop_ratio=0.8, pretrained_backbone_weights=None)
    config.input_features = {"observation.images.top": PolicyFeature(FeatureType.VISUAL, (3, 60, 90))}
    return DiffusionRgbEncoder(config)


def images():
    return torch.randn(2, 3, 60, 90, generator=torch.Generator().manual_seed(0))


def test_acting_sees_the_same_pixels(encoder):
    expected = encoder.center_crop(encoder.resize(images()))
    assert expected.shape == (2, 3, 32, 40)
    assert torch.equal(ImageView((40, 50), (32, 40))(images()), expected)


def test_training_sees_one_of_the_same_parts(encoder):
    whole = encoder.resize(images())
    parts = {
        whole[i, :, row : row + 32, column : column + 40].numpy().tobytes()
        for i in range(2)
        for row in range(9)
        for column in range(11)
    }
    torch.manual_seed(0)
    theirs = encoder.maybe_random_crop(whole)
    ours = ImageView((40, 50), (32, 40))(images(), torch.Generator().manual_seed(0))
    assert all(each.contiguous().numpy().tobytes() in parts for each in (*theirs, *ours))
