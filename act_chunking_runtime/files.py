"""What `act-chunking export` writes beside the graph: a policy as numbers and names."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from act_chunking_runtime.draws import DrawSpec
from act_chunking_runtime.errors import ConfigurationError
from act_chunking_runtime.settings import ExecutionSettings

GRAPH, DESCRIPTION = "policy.onnx", "policy.json"
CHUNK = "chunk"  # the graph's output
FORMAT = 1


@dataclass(frozen=True)
class InputSpec:
    """What a robot gives for one input at every control step.

    Attributes:
        shape: (S,) of a vector, (height, width, 3) of a camera's image.
        dtype: ``float32``, or ``uint8`` of images.
    """

    shape: tuple[int, ...]
    dtype: str


@dataclass(frozen=True)
class ActionSpec:
    """What the robot gets.

    Attributes:
        names: of the A dimensions.
        scale: of a normalised action in the robot's units.
        offset: what a normalised 0 is in the robot's units.
        low: least values that are executed, if there is a limit.
        high: greatest values.
        change: largest change from one control step to the next, if there is a limit.
    """

    names: list[str]
    scale: list[float]
    offset: list[float]
    low: list[float] | None = None
    high: list[float] | None = None
    change: list[float] | None = None


@dataclass(frozen=True)
class Description:
    """All that is to be known of an exported policy beside its graph.

    Attributes:
        policy_type: as LeRobot calls it.
        fps: control steps per second of the demonstrations, if they are known.
        inputs: by LeRobot's names.
        n_obs_steps: observations that the graph takes of each input.
        obs_stride: control steps between them.
        draws: random numbers that the graph takes.
        execution: how chunks become actions.
        actions: what the robot gets.
        opset: of the graph.
    """

    policy_type: str
    fps: float | None
    inputs: dict[str, InputSpec]
    n_obs_steps: int
    obs_stride: int
    draws: list[DrawSpec]
    execution: ExecutionSettings
    actions: ActionSpec
    opset: int

    def text(self) -> str:
        """As JSON."""
        return json.dumps({"format": FORMAT, **asdict(self)}, indent=1)

    @classmethod
    def read(cls, folder: Path) -> "Description":
        """From an exported folder.

        Raises:
            ConfigurationError: there is none, it is damaged, or from another version.
        """
        try:
            values: dict[str, Any] = json.loads((folder / DESCRIPTION).read_text(encoding="utf-8"))
        except FileNotFoundError as error:
            raise ConfigurationError(
                f"{folder} holds no {DESCRIPTION}: give a folder that act-chunking export has written"
            ) from error
        except (OSError, ValueError) as error:
            raise ConfigurationError(f"{folder / DESCRIPTION} cannot be read: {error}") from error
        version = values.pop("format", None) if isinstance(values, dict) else None
        if version != FORMAT:
            raise ConfigurationError(
                f"{folder / DESCRIPTION} has the format {version}, but this runtime reads {FORMAT}: export "
                "the checkpoint with the version of this package that the robot has"
            )
        try:
            inputs = {key: InputSpec(**_tuples(value)) for key, value in values.pop("inputs").items()}
            return cls(
                inputs=inputs,
                draws=[DrawSpec(**_tuples(value)) for value in values.pop("draws")],
                execution=ExecutionSettings(**_tuples(values.pop("execution"))),
                actions=ActionSpec(**values.pop("actions")),
                **values,
            )
        except (KeyError, TypeError, AttributeError) as error:
            raise ConfigurationError(f"{folder / DESCRIPTION} is damaged: {error}") from error


def _tuples(values: dict[str, Any]) -> dict[str, Any]:
    """What JSON reads as lists, as the tuples that they were."""
    return {key: tuple(value) if isinstance(value, list) else value for key, value in values.items()}
