"""Processes with usual settings, where a test is about others."""

from lerobot_act_chunking.sampling.process import Diffusion, Flow


def make_diffusion(
    prediction_type: str = "epsilon",
    num_train_timesteps: int = 100,
    beta_schedule: str = "squaredcos_cap_v2",
    beta_start: float = 1e-4,
    beta_end: float = 0.02,
) -> Diffusion:
    return Diffusion(prediction_type, num_train_timesteps, beta_schedule, beta_start, beta_end)


def make_flow(prediction_type: str = "velocity", time_distribution: str = "uniform") -> Flow:
    return Flow(prediction_type, time_distribution)
