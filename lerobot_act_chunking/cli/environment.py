"""Which simulation a command runs a policy in: ``--env.FIELD=VALUE``, as LeRobot's commands spell it."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

if TYPE_CHECKING:
    from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec

PREFIX, FIELD = "--env.", "--env.FIELD"
PACKAGES = "discover_packages_path"
DEFAULT_TASK = "transfer_cube"

Fields = Annotated[
    list[str] | None,
    typer.Option(
        "--env.type",
        FIELD,
        metavar="VALUE",
        help="Any environment that LeRobot can make, and any field of its configuration: --env.type=pusht "
        "--env.obs_type=pixels_agent_pos; with --env.discover_packages_path=PACKAGE, of your own.",
    ),
]
Task = Annotated[
    str | None,
    typer.Option("--task", help="Short for --env.type=... --env.task=NAME, as insertion or FetchPush-v4."),
]
Success = Annotated[
    str | None,
    typer.Option(
        "--success",
        help="With --task: --env.success, the success rule. ALOHA: touch or hold; gymnasium-robotics: any or "
        "final. \\[default: the first]",
    ),
]
SuccessKey = Annotated[
    str | None,
    typer.Option(
        "--success-key",
        help="What the environment's info calls success, as succeed, where it is not LeRobot's is_success.",
    ),
]


class EnvironmentCommand(TyperCommand):
    """A command with `Fields`, all of which come to it as ``FIELD=VALUE``."""

    prefix = PREFIX

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As of every command, with each ``--env.name`` as a value of the one option that is declared."""
        return super().parse_args(ctx, list(gathered(ctx, args, self.prefix)))


def asked_environment(
    given: Sequence[str] | None,
    task: str | None,
    success: str | None = None,
    *,
    success_key: str | None = None,
    short: str = "--task",
) -> "EnvironmentSpec | None":
    """The environment that the options ask for; None if they ask for none.

    Args:
        given: of `Fields`.
        task: the short spelling.
        success: its success rule.
        success_key: of ``info``, in place of LeRobot's.
        short: the option that ``task`` comes from.

    Raises:
        ConfigurationError: both spellings, a rule without a task, fields without a type, a value that cannot
            be read, a key without an environment, or what `EnvironmentSpec` and `task_environment` refuse.
    """
    if not (given or task or success):
        _check_key(success_key, short)
        return None
    return replace(_asked(given, task, success, short), success_key=success_key or None)


def environment_to_run(
    given: Sequence[str] | None, task: str | None, success: str | None, *, success_key: str | None = None
) -> "EnvironmentSpec":
    """As `asked_environment`, but that of `DEFAULT_TASK` where none is asked for."""
    if not (given or task):
        _check_key(success_key, "--task")
        task = DEFAULT_TASK
    return replace(_asked(given, task, success, "--task"), success_key=success_key or None)


def _check_key(success_key: str | None, short: str) -> None:
    from lerobot_act_chunking.errors import ConfigurationError

    if success_key:
        raise ConfigurationError(
            f"--success-key={success_key} is of which environment? Give --env.type or {short} as well"
        )


def _asked(
    given: Sequence[str] | None, task: str | None, success: str | None, short: str
) -> "EnvironmentSpec":
    from lerobot_act_chunking.diagnostics.core.environments import task_environment
    from lerobot_act_chunking.errors import ConfigurationError

    if given and (task or success):
        said = f"{short} {task}" if task else f"--success {success}"
        raise ConfigurationError(
            f"{said} is short for an environment, and {PREFIX}{given[0]} spells one out: give one of them"
        )
    if given:
        return _spelled_out(given)
    if task is None:
        raise ConfigurationError(
            f"--success={success} is a rule of the tasks of --task: leave it out, or give --task"
        )
    return task_environment(task, success)


def _spelled_out(given: Sequence[str]) -> "EnvironmentSpec":
    from lerobot_act_chunking.diagnostics.core.environments import EnvironmentSpec
    from lerobot_act_chunking.errors import ConfigurationError

    pairs = [(name, value) for name, _, value in (each.partition("=") for each in given)]
    packages = tuple(value for name, value in pairs if name == PACKAGES)
    arguments = _nested((name, value) for name, value in pairs if name != PACKAGES)
    env_type = arguments.pop("type", None)
    if env_type is None:
        raise ConfigurationError(f"{PREFIX}{given[0]} is of which environment? Give --env.type as well")
    return EnvironmentSpec(str(env_type), arguments, packages)


def gathered(ctx: Any, args: Sequence[str], prefix: str) -> Iterator[str]:
    """Arguments in which ``--env.name=value`` and ``--env.name value`` are ``--env.FIELD=name=value``."""
    rest = iter(args)
    for arg in rest:
        if arg == "--":
            yield arg
            yield from rest
        elif arg.startswith(prefix):
            name, equals, value = arg.removeprefix(prefix).partition("=")
            yield f"{prefix}FIELD={name}={value if equals else _next(ctx, rest, arg)}"
        else:
            yield arg


def _next(ctx: Any, rest: Iterator[str], option: str) -> str:
    value = next(rest, "--")
    if value.startswith("--"):
        ctx.fail(f"Option '{option}' requires an argument.")
    return value


def _nested(given: Iterable[tuple[str, str]]) -> dict[str, Any]:
    """Values by their names; those of ``a.b`` are in a dictionary called ``a``."""
    from lerobot_act_chunking.errors import ConfigurationError

    found: dict[str, Any] = {}
    for name, text in given:
        *parents, last = name.split(".")
        place: Any = found
        for parent in parents:
            place = place.setdefault(parent, {})
            if not isinstance(place, dict):
                raise ConfigurationError(f"{PREFIX}{name} is a part of what --env.{parent} gives as a whole")
        place[last] = _read(name, text)
    return found


def _read(name: str, text: str) -> Any:
    """A value as LeRobot's commands read it, which is YAML."""
    import yaml

    from lerobot_act_chunking.errors import ConfigurationError

    try:
        return yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise ConfigurationError(f"{PREFIX}{name}={text} cannot be read: {error}") from error
