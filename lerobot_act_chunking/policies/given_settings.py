"""What was given of a configuration, apart from what presets filled in."""

from dataclasses import fields
from typing import Any, Self


class GivenSettings:
    """Mixin for policy configurations that resolve fields on construction: it remembers what they were."""

    def __post_init__(self) -> None:
        super().__post_init__()  # pyright: ignore[reportAttributeAccessIssue]  (LeRobot's, behind this class)
        self._given = {each.name: getattr(self, each.name) for each in fields(self)}  # pyright: ignore[reportArgumentType]

    def given(self, name: str) -> Any:
        """The value of a field as it was given, before a preset filled it in."""
        return self._given[name]

    def variant(self, **changes: Any) -> Self:
        """What the same given settings with these changes make.

        Raises:
            ConfigurationError: they cannot work.
        """
        return type(self)(**{**self._given, **changes})
