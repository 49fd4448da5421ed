"""Finding out at the start of a run whether its push at the end can work."""

from typing import Protocol

import httpx
from huggingface_hub import constants, get_session, get_token
from huggingface_hub.errors import HfHubHTTPError, OfflineModeIsEnabled
from huggingface_hub.utils import build_hf_headers, hf_raise_for_status

from lerobot_act_chunking import durable_files
from lerobot_act_chunking.compat import hub_incompatibility
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.hub import publishing
from lerobot_act_chunking.hub.names import RepoName
from lerobot_act_chunking.hub.refusal import RefusedError
from lerobot_act_chunking.hub.repository import MAIN
from lerobot_act_chunking.hub.routing import LOCAL_HUB, configured_hub
from lerobot_act_chunking.hub.storage import LocalHub

TIMEOUT = 10.0
"""How long to wait for the real Hub's answer [s]."""

_WAYS_OUT = f"""Three ways out:
  1. keep everything in a folder:  {LOCAL_HUB}=/path/to/hub lerobot-train ...
  2. use the real Hub:             hf auth login
  3. do not push:                  --policy.push_to_hub=false"""


class PushSettings(Protocol):
    """The part of a policy configuration that says whether and where to push."""

    push_to_hub: bool
    repo_id: str | None


def check_push(config: PushSettings) -> None:
    """Fail now if the push at the end of this run would fail.

    LeRobot checks only that ``repo_id`` is set; the rest would surface after the last training step.

    Raises:
        ConfigurationError: the run would push, and neither the local hub nor the real one can take it.
    """
    if not config.push_to_hub:
        return
    hub = configured_hub()
    if hub is None:
        _check_real_hub(config.repo_id)
    elif config.repo_id is not None:  # LeRobot itself asks for a missing one
        _check_routing()
        _check_local_hub(hub, config.repo_id)


def _check_routing() -> None:
    """What was meant for a folder does not go out into the world."""
    reason = hub_incompatibility()
    if reason is not None:
        raise ConfigurationError(
            f"{LOCAL_HUB} is set, but pushes cannot be led there ({reason}): set --policy.push_to_hub=false, "
            f"or unset {LOCAL_HUB} to push to the real Hub"
        )


def _check_local_hub(hub: LocalHub, repo_id: str) -> None:
    try:
        name = hub.full_name(RepoName.checked("model", repo_id))
        if hub.holds(name):
            repository = hub.open(name)
            parent = publishing.parent_of(repository, MAIN)
            if parent is not None:
                repository.commit(parent)
        else:
            name.creatable()
        with hub.lock(name), durable_files.scratch_path(hub.root / ".locks") as probe:
            probe.touch()
    except (OSError, RefusedError) as error:
        raise ConfigurationError(
            f"this run could not push {repo_id!r} to {LOCAL_HUB}={hub.root}: {error}"
        ) from error


def _check_real_hub(repo_id: str | None) -> None:
    reason = _why_unreachable()
    if reason is not None:
        what = f"push to {repo_id!r}" if repo_id else "push (--policy.push_to_hub is on by default)"
        raise ConfigurationError(f"this run would {what} when it ends, but {reason}. {_WAYS_OUT}")


def _why_unreachable() -> str | None:
    if constants.HF_HUB_OFFLINE:
        return "HF_HUB_OFFLINE is set"
    if get_token() is None:
        return "nobody is logged in to the Hugging Face Hub"
    try:
        address = f"{constants.ENDPOINT}/api/whoami-v2"
        hf_raise_for_status(get_session().get(address, headers=build_hf_headers(), timeout=TIMEOUT))
    except HfHubHTTPError as error:
        return f"{constants.ENDPOINT} does not accept the login: {str(error).splitlines()[0]}"
    except (httpx.HTTPError, OSError, OfflineModeIsEnabled) as error:
        return f"{constants.ENDPOINT} cannot be reached: {error}"
    return None
