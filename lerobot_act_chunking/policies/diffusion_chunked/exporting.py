"""How `diffusion_chunked` acts, for export."""

from collections.abc import Mapping

from torch import Tensor

from act_chunking_runtime.draws import DrawSpec
from lerobot_act_chunking.data.batch import Observation
from lerobot_act_chunking.policies.diffusion_chunked.denoising import Denoising
from lerobot_act_chunking.policies.diffusion_chunked.modeling_diffusion_chunked import DiffusionChunkedPolicy
from lerobot_act_chunking.policies.exporting.acting import Acting
from lerobot_act_chunking.sampling.solvers import LinearSampler

NOISE, ON_THE_WAY = "noise", "noise_on_the_way"


def acting_of(policy: DiffusionChunkedPolicy) -> Acting:
    """Chunks from the noise that sampling starts from, and what the sampler adds to it."""
    config, sampler = policy.config, policy._samplers.get()
    n_samples = config.execution_settings.n_samples or 1
    shape = (n_samples, config.horizon, *policy.feature_spec.action)
    draws = []
    if config.objective != "two_step":
        moments = config.chunk_stride if config.warm_start == "noise_hold" else None
        draws.append(DrawSpec(NOISE, shape, "normal", moment_steps=moments))
    n_added = sum(step.noise > 0 for step in sampler.steps) if isinstance(sampler, LinearSampler) else 0
    if n_added:
        draws.append(DrawSpec(ON_THE_WAY, (n_added, *shape), "normal"))

    def chunks(window: Observation, drawn: Mapping[str, Tensor]) -> Tensor:
        noise = drawn[NOISE] if NOISE in drawn else policy._example.new_zeros(shape)
        added = iter(drawn[ON_THE_WAY] if n_added else ())
        denoising = Denoising(policy._network, policy.process, config.guidance_scale)
        keyframes = denoising.sample(window, sampler, noise, lambda _: next(added))
        return policy._control_steps(keyframes, config.n_action_steps).unflatten(0, (n_samples, 1))

    return Acting(chunks, draws)
