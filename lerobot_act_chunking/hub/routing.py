"""Routing huggingface_hub, and with it LeRobot, to the folder that ``LEROBOT_LOCAL_HUB`` names."""

import logging
import os
from pathlib import Path

import httpx
from huggingface_hub import constants

from lerobot_act_chunking.compat import hub_incompatibility
from lerobot_act_chunking.errors import ConfigurationError
from lerobot_act_chunking.hub.storage import LocalHub
from lerobot_act_chunking.hub.transport import LocalHubTransport

LOCAL_HUB = "LEROBOT_LOCAL_HUB"
"""Environment variable: the folder that takes the Hub's place."""
FALL_THROUGH = "LEROBOT_LOCAL_HUB_FALL_THROUGH"
"""Environment variable: with ``1``, repositories the folder does not hold are read from the real Hub."""

logger = logging.getLogger(__name__)


def configured_hub() -> LocalHub | None:
    """The hub that the environment names, if it names one."""
    folder = os.environ.get(LOCAL_HUB)
    return LocalHub(folder) if folder else None


def install() -> None:
    """Send huggingface_hub's requests to the local hub; without ``LEROBOT_LOCAL_HUB`` nothing changes.

    Harmless to call twice. Processes started later inherit the environment and call it themselves. A
    huggingface_hub that cannot be routed is left alone, with one line in the log.
    """
    hub = configured_hub()
    if hub is None:
        return
    reason = hub_incompatibility()
    if reason is None:
        route_to(hub, fall_through=os.environ.get(FALL_THROUGH) == "1")
    else:
        logger.warning("the local hub is off and the real Hub is asked: %s", reason)


def route_to(hub: LocalHub, *, fall_through: bool = False) -> None:
    """Make every request of huggingface_hub in this process go to ``hub``."""

    from huggingface_hub import set_client_factory  # here: this module loads without it, to say so

    def client() -> httpx.Client:
        # Raised here, by the first request: an error while LeRobot imports plugins would only be logged.
        _refuse_download_cache(hub)
        transport = LocalHubTransport(hub, fall_through=fall_through)
        # An explicit transport also keeps proxies of the environment out of the way.
        return httpx.Client(transport=transport, follow_redirects=True, timeout=None)  # noqa: S113

    _adapt_huggingface_hub()
    set_client_factory(client)


def _adapt_huggingface_hub() -> None:
    """The one place that depends on huggingface_hub's inside, and where a change of LeRobot's main would go.

    Xet uploads bypass the client factory (they are a separate Rust client), so they have to be off.
    """
    constants.HF_HUB_DISABLE_XET = True
    os.environ["HF_HUB_DISABLE_XET"] = "1"


def _refuse_download_cache(hub: LocalHub) -> None:
    """Downloads move refs without taking the hub's lock; in the hub itself that could undo a push."""
    # LeRobot keeps downloaded datasets in a cache of its own; asking LeRobot for it would import torch.
    lerobot_home = Path(os.environ.get("HF_LEROBOT_HOME") or Path(constants.HF_HOME) / "lerobot")
    for variable, cache in (
        ("HF_HUB_CACHE", constants.HF_HUB_CACHE),
        ("HF_LEROBOT_HOME", lerobot_home / "hub"),
    ):
        if Path(cache).expanduser().resolve() == hub.root.resolve():
            raise ConfigurationError(
                f"{LOCAL_HUB} and {variable} name the same folder {hub.root}: downloads could undo a push. "
                f"Unset {variable} (loads then keep their own copy), or unset {LOCAL_HUB} to read only."
            )
