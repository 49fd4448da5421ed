"""A backbone for small images on a CPU."""

from jaxtyping import Float
from torch import Tensor, nn

from lerobot_act_chunking.nn.vision.layers import ChannelsLastInEval, group_norm


class SmallCnn(ChannelsLastInEval):
    """Four stride-2 convolutions for small images on a CPU: 0.39 M parameters, stride 16."""

    CHANNELS = (32, 64, 128, 256)

    def __init__(self):
        super().__init__()
        layers: list[nn.Module] = []
        for c_in, c_out in zip((3, *self.CHANNELS), self.CHANNELS, strict=False):
            layers += [
                nn.Conv2d(c_in, c_out, 3, stride=2, padding=1, bias=False),
                group_norm(c_out),
                nn.ReLU(inplace=True),
            ]
        self.layers = nn.Sequential(*layers)

    def forward(self, images: Float[Tensor, "B 3 H W"]) -> Float[Tensor, "B C h w"]:
        """Feature map of 256 channels, one cell per 16 x 16 pixels."""
        return self.layers(images)
