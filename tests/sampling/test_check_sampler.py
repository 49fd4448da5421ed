import pytest
from processes import make_diffusion

from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.sampling.samplers import check_sampler, make_sampler


@pytest.mark.parametrize(
    ("process", "name", "n", "settings", "message"),
    [
        ("ddqm", "ddim", 10, {}, "unknown process 'ddqm'; choose one of: flow, ddpm, two_step"),
        ("ddpm", "euler", 10, {}, "unknown sampler for ddpm 'euler'; choose one of: ddim, ddpm, dpm\\+\\+"),
        (
            "flow",
            "ddim",
            10,
            {},
            "unknown sampler for flow 'ddim'; choose one of: euler, midpoint, heun, rk4",
        ),
        ("ddpm", "ddim", 0, {}, "num_inference_steps must be at least 1, but is 0"),
        ("ddpm", "ddim", 101, {}, "num_inference_steps, 101, is above num_train_timesteps, 100"),
        ("ddpm", "ddim", 1, {}, "one step of ddim with leading spacing .* set timestep_spacing=trailing"),
        (
            "ddpm",
            "dpm++",
            51,
            {},
            "dpm\\+\\+ with 51 of 100 .* set num_inference_steps=50 or less, or sampler=ddim",
        ),
        (
            "ddpm",
            "dpm++",
            10,
            {"spacing": "leading"},
            "dpm\\+\\+ has trailing timestep spacing, not 'leading'",
        ),
        ("ddpm", "ddim", 10, {"spacing": "even"}, "unknown timestep spacing 'even'; choose one of: leading"),
        ("flow", "euler", 10, {"spacing": "leading"}, "euler has no timestep spacing, but it is 'leading'"),
        (
            "flow",
            "euler",
            10,
            {"clip_mode": "lerobot"},
            "clip_mode 'lerobot' is for ddim and ddpm, not for euler",
        ),
        ("ddpm", "ddim", 10, {"clip_mode": "hard"}, "unknown clip_mode 'hard'; choose one of: consistent, l"),
        ("flow", "heun", 10, {"strength": 0.0}, "strength must be above 0 and at most 1, but is 0.0"),
        ("flow", "heun", 10, {"strength": 1.5}, "strength must be above 0 and at most 1, but is 1.5"),
        ("two_step", "two_step", 3, {}, "two_step makes 2 steps, but num_inference_steps is 3"),
        ("two_step", "two_step", 2, {"strength": 0.5}, "two_step does not start from noised actions"),
    ],
)
def test_impossible_settings_are_refused(process: str, name: str, n: int, settings, message: str):
    with pytest.raises(ConfigurationError, match=message):
        check_sampler(process, name, n, num_train_timesteps=100, **settings)


def test_making_a_sampler_checks_its_settings_against_the_process():
    with pytest.raises(ConfigurationError, match="11, is above num_train_timesteps, 10"):
        make_sampler(make_diffusion(num_train_timesteps=10), "ddim", 11)
    with pytest.raises(ConfigurationError, match="dpm\\+\\+ with 6 of 10"):
        make_sampler(make_diffusion(num_train_timesteps=10), "dpm++", 6)
