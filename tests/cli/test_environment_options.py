"""``--env.FIELD=VALUE`` is read as LeRobot's own commands read it."""

from dataclasses import dataclass

import draccus
import pytest
import typer
from hypothesis import given, settings
from hypothesis import strategies as st
from lerobot.envs.configs import EnvConfig
from tiers import draws

from lerobot_act_chunking.cli.environment import (
    EnvironmentCommand,
    Fields,
    Success,
    Task,
    asked_environment,
    environment_to_run,
)
from lerobot_act_chunking.cli.main import main
from lerobot_act_chunking.cli.running import run
from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec, task_environment
from lerobot_act_chunking.errors import ConfigurationError

VALUES = {
    "task": st.sampled_from(["transfer_cube", "insertion"]),
    "obs_type": st.sampled_from(["state", "pixels_state"]),
    "observation_height": st.integers(1, 4096).map(str),
    "render_quality": st.sampled_from(["full", "'fast'"]),
    "cameras": st.sampled_from(["[top]", '["angle", "top"]']),
    "agent_vel": st.sampled_from(["true", "false", "True"]),
    "success": st.sampled_from(["touch", '"hold"']),
}
EQUALS = st.booleans()


@dataclass
class Command:
    """The part of LeRobot's commands that is about the environment."""

    env: EnvConfig


@pytest.fixture(scope="module")
def asked():
    """What a command hears of a list of arguments: its environment, and all other arguments."""
    heard = []

    def command(
        name: str = typer.Argument("nothing"),
        env: Fields = None,
        task: Task = None,
        success: Success = None,
        seed: int = 0,
    ) -> None:
        heard.append((asked_environment(env, task, success), name, seed))

    app = typer.Typer(pretty_exceptions_enable=False)
    app.command(cls=EnvironmentCommand)(command)

    def ask(*arguments):
        assert run(app, list(arguments), "command") == 0
        return heard.pop()

    return ask


@settings(max_examples=draws(30, 300), deadline=None)
@given(st.fixed_dictionaries({}, optional=VALUES), st.data())
def test_fields_are_those_of_lerobots_own_parser(asked, options, data):
    spelled = []
    for name, value in {"type": "aloha_sim", **options}.items():
        spelled += [f"--env.{name}={value}"] if data.draw(EQUALS) else [f"--env.{name}", value]
    theirs = draccus.parse(Command, args=spelled).env
    spec, name, seed = asked("--seed", "7", *spelled, "policy")
    assert (name, seed) == ("policy", 7)
    assert EnvConfig.get_choice_class(spec.type)(**spec.options()) == theirs


@pytest.mark.parametrize(
    ("arguments", "spec"),
    [
        ([], None),
        (["--task", "insertion"], task_environment("insertion")),
        (["--task", "FetchPush-v4", "--success", "final"], task_environment("FetchPush-v4", "final")),
        (["--env.type=aloha_sim"], EnvironmentSpec("aloha_sim")),
        (
            ["--env.success=touch", "--env.type", "aloha_sim"],
            EnvironmentSpec("aloha_sim", {"success": "touch"}),
        ),
        (
            ["--env.type=pusht", "--env.obs_type=a", "--env.obs_type=b=c"],
            EnvironmentSpec("pusht", {"obs_type": "b=c"}),
        ),
        (["--env.type=aloha", "--env.fps", "-1"], EnvironmentSpec("aloha", {"fps": -1})),
        (
            [
                "--env.type=gym_manipulator",
                "--env.processor.gripper.gripper_penalty=0.5",
                "--env.name=x",
                "--env.processor.gripper.use_gripper=false",
                "--env.processor.control_mode=leader",
            ],
            EnvironmentSpec(
                "gym_manipulator",
                {
                    "processor": {
                        "gripper": {"gripper_penalty": 0.5, "use_gripper": False},
                        "control_mode": "leader",
                    },
                    "name": "x",
                },
            ),
        ),
        (
            ["--env.type=aloha", "--env.discover_packages_path=json", "--env.discover_packages_path=email"],
            EnvironmentSpec("aloha", {}, ("json", "email")),
        ),
    ],
)
def test_both_spellings(asked, arguments, spec):
    assert asked(*arguments)[0] == spec


def test_what_comes_behind_two_dashes_is_no_option(asked):
    assert asked("--env.type=aloha_sim", "--", "--env.task=insertion")[:2] == (
        EnvironmentSpec("aloha_sim"),
        "--env.task=insertion",
    )


def test_the_default_task_gives_way_to_every_spelling():
    assert environment_to_run(None, None, None) == task_environment("transfer_cube")
    assert environment_to_run(None, None, "hold") == task_environment("transfer_cube", "hold")
    assert environment_to_run(None, "insertion", None) == task_environment("insertion")
    assert environment_to_run(["type=pusht"], None, None) == EnvironmentSpec("pusht")


@pytest.mark.parametrize(
    ("given_fields", "task", "success", "message"),
    [
        (["type=aloha_sim"], "insertion", None, r"--task insertion is short .* --env\.type=aloha_sim spells"),
        (["type=aloha_sim"], None, "hold", "--success hold is short"),
        (None, None, "hold", "--success=hold is a rule of the tasks of --task"),
        (["task=insertion"], None, None, r"--env\.task=insertion is of which environment\? Give --env\.type"),
        (["type=aloha_sim", "cameras=["], None, None, r"--env\.cameras=\[ cannot be read: while parsing"),
        (["type=gym_manipulator", "processor=1", "processor.a=2"], None, None, "is a part of what"),
    ],
)
def test_wrong_questions_are_refused(given_fields, task, success, message):
    with pytest.raises(ConfigurationError, match=message):
        asked_environment(given_fields, task, success)


def test_the_short_option_is_called_by_its_name():
    with pytest.raises(ConfigurationError, match="--success insertion is short"):
        asked_environment(["type=aloha_sim"], "insertion", short="--success")


@pytest.mark.parametrize("command", ["motion", "smoothness"])
def test_commands_refuse_before_they_look_for_a_checkpoint(command, capsys):
    assert main([command, "./nowhere", "--env.type=aloha_sim", "--env.tsak=insertion"]) == 1
    assert "aloha_sim has no --env.tsak; did you mean --env.task?" in capsys.readouterr().err
    assert main([command, "./nowhere", "--env.type=moon"]) == 1
    assert "unknown environment type 'moon'" in capsys.readouterr().err
    assert main([command, "./nowhere", "--env.type", "--seed", "3"]) == 2
    assert "Option '--env.type' requires an argument" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["motion", "smoothness"])
def test_help_shows_the_option_and_its_fields(command, capsys):
    assert main([command, "--help"]) == 0
    printed = " ".join(capsys.readouterr().out.replace("│", "").split())
    assert "--env.type,--env.FIELD" in printed
    assert "any field of its configuration" in printed
