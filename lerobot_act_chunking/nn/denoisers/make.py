"""From a denoiser's name to the denoiser."""

from lerobot_act_chunking.errors import look_up
from lerobot_act_chunking.nn.denoisers.denoiser import Denoiser
from lerobot_act_chunking.nn.denoisers.dit import Dit
from lerobot_act_chunking.nn.denoisers.mixer import Mixer
from lerobot_act_chunking.nn.denoisers.spec import DenoiserInputs, DenoiserSpec
from lerobot_act_chunking.nn.denoisers.unet1d import Unet1d

DENOISERS: dict[str, type[Denoiser]] = {
    "mixer": Mixer,
    "dit": Dit,
    "unet1d": Unet1d,
}
"""The denoisers. What is listed here can be asked for as ``denoiser``."""


def make_denoiser(spec: DenoiserSpec, inputs: DenoiserInputs) -> Denoiser:
    """A fresh denoiser.

    Raises:
        ConfigurationError: there is none of this name, or a value cannot work.
    """
    return look_up("denoiser", spec.denoiser, DENOISERS).from_spec(spec, inputs)
