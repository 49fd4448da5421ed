"""LeRobot's command line has one argument per field name, shared by every policy that is registered."""

import typing
from dataclasses import fields

import draccus
import pytest
from command_line import Command
from lerobot.configs import PreTrainedConfig
from policy_cases import MODULES as OURS
from policy_cases import of_every_type


@pytest.fixture(scope="module")
def policies() -> dict[str, type]:
    import lerobot.policies  # noqa: F401  (registers LeRobot's)

    return PreTrainedConfig.get_known_choices()


def test_no_choice_of_ours_restricts_a_field_of_lerobots(policies: dict[str, type]) -> None:
    theirs = {field.name for name, config in policies.items() if name not in OURS for field in fields(config)}
    assert {"objective", "feedforward_activation", "beta_schedule"} <= theirs
    for name in OURS:
        for field, hint in typing.get_type_hints(policies[name]).items():
            assert typing.get_origin(hint) is not typing.Literal or field not in theirs, (name, field)
        for field in fields(policies[name]):
            assert "custom_args" not in field.metadata or field.name not in theirs, (name, field.name)


@pytest.mark.usefixtures("policies")
@pytest.mark.parametrize(
    ("policy", "field", "value"),
    [
        ("multi_task_dit", "objective", "diffusion"),
        ("act", "feedforward_activation", "glu"),
        ("diffusion", "prediction_type", "sample"),
        *of_every_type("CHOICES"),
    ],
)
def test_every_policy_keeps_its_choices(policy: str, field: str, value: str) -> None:
    command = draccus.parse(Command, args=[f"--policy.type={policy}", f"--policy.{field}={value}"])
    assert getattr(command.policy, field) == value
