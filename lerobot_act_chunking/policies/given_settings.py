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

    def settle(self, **changes: Any) -> None:
        """Set fields as if they had been given, and what follows from them.

        Raises:
            ConfigurationError: they cannot work.
        """
        before, after = self.variant(), self.variant(**changes)
        for each in fields(self):  # pyright: ignore[reportArgumentType]
            if getattr(before, each.name) != (value := getattr(after, each.name)):
                setattr(self, each.name, value)
        self._given |= changes
