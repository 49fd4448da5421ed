"""How every diagnosis ends: a judgement with its exit status, and all numbers as JSON."""

import json
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar

# Apart from 1 (refused) and 2 (wrong usage), so that a script can tell a bad policy from a missing file.
EXIT_CODES = {"pass": 0, "warn": 0, "inconclusive": 10, "fail": 11}


@dataclass(frozen=True)
class Judgement:
    """The answer of an instrument.

    Attributes:
        verdict: pass, warn, fail or inconclusive.
        reasons: why, in whole sentences.
    """

    verdict: str
    reasons: list[str]


def with_untrained[J: Judgement](judgement: J, untrained: str | None) -> J:
    """The judgement; where the policy is (as good as) untrained that comes first, and it passes nothing."""
    if untrained is None:
        return judgement
    verdict = "warn" if judgement.verdict == "pass" else judgement.verdict
    return replace(judgement, verdict=verdict, reasons=[untrained, *judgement.reasons])


@dataclass(frozen=True, kw_only=True)
class Report(ABC):
    """Everything that an instrument found: the command prints it, JSON holds it, plots draw it.

    Attributes:
        tool: the instrument's name.
        judgement: its answer.
    """

    tool: ClassVar[str]
    judgement: Judgement

    @property
    def verdict(self) -> str:
        """Pass, warn, fail or inconclusive."""
        return self.judgement.verdict

    @property
    def reasons(self) -> list[str]:
        """Why, in whole sentences."""
        return self.judgement.reasons

    @property
    def exit_code(self) -> int:
        """Of the command: 0 pass or warn, 10 inconclusive, 11 fail."""
        return EXIT_CODES[self.verdict]

    @abstractmethod
    def content(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dictionaries; None for what was not or cannot be measured."""

    def to_json(self) -> dict[str, Any]:
        """The content behind the names of the tool and of the package's version."""
        return {"tool": self.tool, "version": version("lerobot_policy_act_chunking"), **self.content()}

    def write(self, path: Path) -> Path:
        """Write `to_json` to a file, creating its folder; returns the path."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(self.to_json(), indent=1, allow_nan=False) + "\n")
        return path
